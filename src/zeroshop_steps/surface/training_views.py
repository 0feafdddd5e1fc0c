"""Training views: registered images with their masks, resized and cropped to the pixels that matter."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.crops import STRIDE_PX, Crop, ObjectSphere, crop, crop_for_seeds, grid_camera
from zeroshop_steps.geometry.registered_views import read_object_masks, read_views
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.tiling import find_active_tiles


@dataclass(frozen=True)
class TrainingView:
    """One image, cropped to its mask and a border.

    Attributes:
        camera: pinhole camera of the crop, in normalized coordinates.
        color: (3, H, W) float32 RGB in [0, 1], black outside the mask.
        mask: (H, W) float32 coverage of each pixel by the object, 0 to 1.
        active: (H, W) bool, the pixels that count in the loss: the mask and the border around it.
        tile_active: (ceil(H / 16), ceil(W / 16)) bool, the tiles that hold active pixels.
    """

    camera: Camera
    color: torch.Tensor
    mask: torch.Tensor
    active: torch.Tensor
    tile_active: np.ndarray


@dataclass(frozen=True)
class CameraSet:
    """What a registration holds: the sparse model, and images and masks (bool) in the order of its cameras."""

    model: SparseModel
    images: tuple[np.ndarray, ...]
    masks: tuple[np.ndarray, ...]


def read_camera_set(folder: Path) -> CameraSet:
    """Read images, masks and cameras of a registration.

    Raises:
        StepError: something is missing or does not fit; the message names it.
    """
    views, model = read_views(folder)
    if len(views) < 3:
        raise StepError(f"{folder}/sparse holds {len(views)} cameras; at least 3 are needed to see depth. Run registration again")
    return CameraSet(model, tuple(view.image() for view in views), tuple(read_object_masks(views)))


def make_training_views(camera_set: CameraSet, sphere: ObjectSphere, image_width_px: int, border_px: int) -> list[TrainingView]:
    """Resize to `image_width_px` (never enlarge), crop to the mask's box and `border_px` around it, and make the background black."""
    parts = zip(camera_set.model.cameras, camera_set.images, camera_set.masks, strict=True)
    return [_training_view(image, mask, crop(camera, mask, sphere, image_width_px, border_px)) for camera, image, mask in parts]


def make_seed_views(camera_set: CameraSet, sphere: ObjectSphere) -> list[TrainingView]:
    """The views in which stereo searches for seeds."""
    parts = zip(camera_set.model.cameras, camera_set.images, camera_set.masks, strict=True)
    return [_training_view(image, mask, crop_for_seeds(camera, mask, sphere)) for camera, image, mask in parts]


def _training_view(image: np.ndarray, mask: np.ndarray, crop: Crop) -> TrainingView:
    masked = image * mask[..., None]
    color = cv2.resize(masked.astype(np.float32) / 255.0, crop.size_px, interpolation=cv2.INTER_AREA)[crop.window]
    return TrainingView(
        crop.camera,
        torch.from_numpy(np.ascontiguousarray(color.transpose(2, 0, 1))),
        torch.from_numpy(np.ascontiguousarray(crop.coverage)),
        torch.from_numpy(np.ascontiguousarray(crop.active)),
        find_active_tiles(crop.active),
    )


def make_grid_view(view: TrainingView) -> TrainingView:
    """A view of every third pixel of every third row: those at which stereo estimates planes."""
    s = STRIDE_PX
    active = view.active[::s, ::s]
    return TrainingView(grid_camera(view.camera), view.color[:, ::s, ::s], view.mask[::s, ::s], active, find_active_tiles(active.numpy()))
