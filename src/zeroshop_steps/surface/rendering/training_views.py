"""Training views: registered images with their masks, resized and cropped to the pixels that matter."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch

from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX, Crop, ObjectSphere, crop, crop_for_seeds, grid_camera
from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel
from zeroshop_steps.geometry.cameras.registered_views import find_possible, read_object_masks, read_views
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.rendering.tiling import find_active_tiles


@dataclass(frozen=True)
class TrainingView:
    """One image, cropped to its mask and a border.

    Attributes:
        camera: pinhole camera of the crop, in normalized coordinates.
        color: (3, H, W) float32 RGB in [0, 1], black outside the mask.
        mask: (H, W) float32 coverage of each pixel by the object, 0 to 1.
        active: (H, W) bool, the pixels that count in the loss: the mask and the border around it.
        tile_active: (ceil(H / 16), ceil(W / 16)) bool, the tiles that hold active pixels.
        confidence: (H, W) float32 how sure the mask is of each pixel, 0 to 1; None if it is sure of all.
        pass_number: 1, or that of a later pass, in which the object lay differently.
    """

    camera: Camera
    color: torch.Tensor
    mask: torch.Tensor
    active: torch.Tensor
    tile_active: np.ndarray
    confidence: torch.Tensor | None = None
    pass_number: int = 1

    @property
    def counted(self) -> torch.Tensor:
        """(H, W) how much each pixel counts in the loss: 0 or 1, or in between where the mask is not sure."""
        return self.active if self.confidence is None else self.active * self.confidence

    def to(self, device: torch.device) -> "TrainingView":
        """The view with its images on a device."""
        confidence = None if self.confidence is None else self.confidence.to(device)
        color, mask, active = (image.to(device) for image in (self.color, self.mask, self.active))
        return replace(self, color=color, mask=mask, active=active, confidence=confidence)

    def find_possible(self) -> np.ndarray:
        """(H, W) bool: the pixels that may show the object, at least in part."""
        return find_possible(self.mask.numpy() > 0, None if self.confidence is None else self.confidence.numpy())


@dataclass(frozen=True)
class CameraSet:
    """What a registration holds: the sparse model, and in the order of its cameras images, masks (bool), their confidences and passes."""

    model: SparseModel
    images: tuple[np.ndarray, ...]
    masks: tuple[np.ndarray, ...]
    confidences: tuple[np.ndarray | None, ...]
    pass_numbers: tuple[int, ...]

    def find_possible(self) -> list[np.ndarray]:
        """(H, W) bool of every view: the pixels that may show the object."""
        return [find_possible(*pair) for pair in zip(self.masks, self.confidences, strict=True)]


def read_camera_set(folder: Path) -> CameraSet:
    """Read images, masks and cameras of a registration.

    Raises:
        StepError: something is missing or does not fit; the message names it.
    """
    views, model = read_views(folder)
    if len(views) < 3:
        raise StepError(f"{folder}/sparse holds {len(views)} cameras; at least 3 are needed to see depth. Run registration again")
    images, confidences = tuple(view.image() for view in views), tuple(view.confidence() for view in views)
    return CameraSet(model, images, tuple(read_object_masks(views)), confidences, tuple(view.pass_number for view in views))


def make_training_views(camera_set: CameraSet, sphere: ObjectSphere, image_width_px: int, border_px: int) -> list[TrainingView]:
    """Resize to `image_width_px` (never enlarge), crop to the mask's box and `border_px` around it, and make the background black."""
    pairs = zip(camera_set.model.cameras, camera_set.find_possible(), strict=True)
    return _cut_views(camera_set, [crop(camera, possible, sphere, image_width_px, border_px) for camera, possible in pairs])


def make_seed_views(camera_set: CameraSet, sphere: ObjectSphere) -> list[TrainingView]:
    """The views in which stereo searches for seeds."""
    pairs = zip(camera_set.model.cameras, camera_set.find_possible(), strict=True)
    return _cut_views(camera_set, [crop_for_seeds(camera, possible, sphere) for camera, possible in pairs])


def _cut_views(camera_set: CameraSet, crops: list[Crop]) -> list[TrainingView]:
    parts = zip(camera_set.images, camera_set.masks, camera_set.confidences, camera_set.pass_numbers, crops, strict=True)
    return [_make_view(*part) for part in parts]


def _make_view(image: np.ndarray, mask: np.ndarray, confidence: np.ndarray | None, pass_number: int, crop: Crop) -> TrainingView:
    def cut(picture: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(cv2.resize(picture.astype(np.float32), crop.size_px, interpolation=cv2.INTER_AREA)[crop.window])

    color = cut((image * mask[..., None]).astype(np.float32) / 255.0)
    return TrainingView(
        crop.camera,
        torch.from_numpy(np.ascontiguousarray(color.transpose(2, 0, 1))),
        torch.from_numpy(cut(mask)),
        torch.from_numpy(np.ascontiguousarray(crop.active)),
        find_active_tiles(crop.active),
        None if confidence is None else torch.from_numpy(cut(confidence)),
        pass_number,
    )


def make_grid_view(view: TrainingView) -> TrainingView:
    """A view of every third pixel of every third row: those at which stereo estimates planes."""
    s = STRIDE_PX
    active = view.active[::s, ::s]
    confidence = None if view.confidence is None else view.confidence[::s, ::s]
    tiles = find_active_tiles(active.numpy())
    return TrainingView(grid_camera(view.camera), view.color[:, ::s, ::s], view.mask[::s, ::s], active, tiles, confidence, view.pass_number)
