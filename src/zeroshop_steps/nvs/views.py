"""Training views: registered images with their masks, resampled and cropped to the pixels that matter."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from zeroshop_steps.cameras import Camera, SparseModel
from zeroshop_steps.errors import StepError
from zeroshop_steps.finish.views import read_views

TILE_PX = 16
"""Width and height of a tile: a row of it fills one 512-bit register in single precision."""
STRIDE_PX = 3
"""Stereo finds planes at every third pixel of every third row; patches are compared at the images' own resolution."""


@dataclass(frozen=True)
class ObjectSphere:
    """A sphere around the object: world = centre + radius * normalized. Training happens in normalized coordinates."""

    centre: np.ndarray
    radius: float

    def normalized(self, camera: Camera) -> Camera:
        """The camera seen from normalized coordinates."""
        camera_from_world = camera.camera_from_world.copy()
        camera_from_world[:3, 3] = (camera_from_world[:3, :3] @ self.centre + camera_from_world[:3, 3]) / self.radius
        return Camera(camera.name, camera.width_px, camera.height_px, camera.intrinsics, camera_from_world)


@dataclass(frozen=True)
class TrainingView:
    """One image, cropped to its mask and a border.

    Attributes:
        camera: pinhole camera of the crop, in normalized coordinates.
        color: (3, H, W) float32 RGB in [0, 1], black outside the mask.
        mask: (H, W) float32 coverage of each pixel by the object, 0 to 1.
        active: (H, W) bool, the pixels that count: within the border around the mask.
        tile_active: (ceil(H / 16), ceil(W / 16)) bool, tiles with active pixels.
    """

    camera: Camera
    color: torch.Tensor
    mask: torch.Tensor
    active: torch.Tensor
    tile_active: np.ndarray


@dataclass(frozen=True)
class CameraSet:
    """A `register` output folder: sparse model, its images and masks (bool), in the order of the cameras."""

    model: SparseModel
    images: tuple[np.ndarray, ...]
    masks: tuple[np.ndarray, ...]


def read_camera_set(folder: Path) -> CameraSet:
    """Read images, masks and cameras of a registration. Raises StepError naming what is missing or does not fit."""
    views, model = read_views(folder)
    if len(views) < 3:
        raise StepError(f"{folder}/sparse holds {len(views)} cameras; at least 3 are needed to see depth. Run registration again")
    images, masks = [], []
    for view in views:
        images.append(view.image())
        masks.append(view.mask())
        if not masks[-1].any():
            raise StepError(f"mask {view.mask_path} is empty; segment that image again or leave it out")
    return CameraSet(model, tuple(images), tuple(masks))


def object_sphere(cameras: tuple[Camera, ...], masks: tuple[np.ndarray, ...]) -> ObjectSphere:
    """Centre: the point nearest, in the least-squares sense, to the rays through the masks' box centres.
    Radius: large enough for the largest half diagonal of a mask's box, back-projected to the centre's depth."""
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    half_diagonals = []
    for camera, mask in zip(cameras, masks, strict=True):
        ys, xs = np.nonzero(mask)
        middle = np.array([(xs.min() + xs.max() + 1) / 2, (ys.min() + ys.max() + 1) / 2, 1.0])
        half_diagonals.append(np.hypot(np.ptp(xs) + 1, np.ptp(ys) + 1) / 2)
        ray = camera.camera_from_world[:3, :3].T @ np.linalg.solve(camera.intrinsics, middle)
        ray /= np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        matrix += across
        vector += across @ camera.centre_in_world
    centre = np.linalg.solve(matrix, vector)
    depths = [camera.project(centre[None])[1][0] for camera in cameras]
    if min(depths) <= 0:
        raise StepError("the masked object lies behind a registered camera: the registration is wrong; capture again or drop that image")
    radius = max(half * depth / camera.intrinsics[0, 0] for half, depth, camera in zip(half_diagonals, depths, cameras, strict=True))
    return ObjectSphere(centre, float(radius))


def training_views(
    camera_set: CameraSet, sphere: ObjectSphere, image_width_px: int, border_px: int, names: tuple[str, ...] | None = None
) -> list[TrainingView]:
    """Resample to `image_width_px` (never up), crop to the mask's box and `border_px`, and blacken the background.

    Args:
        names: the images to take, all when None.
    """
    views = []
    for camera, image, mask in zip(camera_set.model.cameras, camera_set.images, camera_set.masks, strict=True):
        if names is not None and camera.name not in names:
            continue
        width_px = min(image_width_px, camera.width_px)
        height_px = round(camera.height_px * width_px / camera.width_px)
        coverage = cv2.resize(mask.astype(np.float32), (width_px, height_px), interpolation=cv2.INTER_AREA)
        masked = image * mask[..., None]
        color = cv2.resize(masked.astype(np.float32) / 255.0, (width_px, height_px), interpolation=cv2.INTER_AREA)
        reach = np.ones((2 * border_px + 1, 2 * border_px + 1), np.uint8)
        active = cv2.dilate((coverage > 0).astype(np.uint8), reach).astype(bool)
        ys, xs = np.nonzero(active)
        x0, x1, y0, y1 = xs.min(), xs.max() + 1, ys.min(), ys.max() + 1
        resized = sphere.normalized(camera).resized(width_px, height_px)
        intrinsics = resized.intrinsics - np.array([[0, 0, x0], [0, 0, y0], [0, 0, 0]])
        crop = (slice(y0, y1), slice(x0, x1))
        views.append(
            TrainingView(
                Camera(camera.name, int(x1 - x0), int(y1 - y0), intrinsics, resized.camera_from_world),
                torch.from_numpy(np.ascontiguousarray(color[crop].transpose(2, 0, 1))),
                torch.from_numpy(np.ascontiguousarray(coverage[crop])),
                torch.from_numpy(np.ascontiguousarray(active[crop])),
                tiles_with(active[crop]),
            )
        )
    return views


def grid_view(view: TrainingView) -> TrainingView:
    """The pixels at which stereo finds planes as a view of their own."""
    camera, s = view.camera, STRIDE_PX
    # The centre of pixel i of the grid is the centre of pixel s * i of the image.
    intrinsics = camera.intrinsics / np.array([[s], [s], [1]]) + np.array([[0, 0, 0.5 - 0.5 / s], [0, 0, 0.5 - 0.5 / s], [0, 0, 0]])
    height_px, width_px = view.mask[::s, ::s].shape
    small = Camera(camera.name, width_px, height_px, intrinsics, camera.camera_from_world)
    active = view.active[::s, ::s]
    return TrainingView(small, view.color[:, ::s, ::s], view.mask[::s, ::s], active, tiles_with(active.numpy()))


def tiles_with(active: np.ndarray) -> np.ndarray:
    """(ceil(H / 16), ceil(W / 16)) bool: tiles of an (H, W) bool array that hold any."""
    height, width = active.shape
    padded = np.zeros((-(-height // TILE_PX) * TILE_PX, -(-width // TILE_PX) * TILE_PX), bool)
    padded[:height, :width] = active
    return padded.reshape(padded.shape[0] // TILE_PX, TILE_PX, padded.shape[1] // TILE_PX, TILE_PX).any(axis=(1, 3))
