"""What the pose estimation of SAM-6D sees: a square crop around a mask, and points with the pixels of the crop that they belong to."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.detect.templates import Templates
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.networks.sam6d.settings import IMAGE_PX
from zeroshop_steps.pose.dataset import NEAR_DIAMETERS

LEAST_POINTS = 8  # measured points of a mask; with no more, it is left out
OBSERVED_POINTS, VIEW_POINTS = 2048, 5000  # that are drawn from a mask in the photo, and from one in a view
HALF_PX = 0.5  # from the corner of a pixel, where the cameras of views count from, to its centre


@dataclass(frozen=True)
class PointCrop:
    """A square crop and N points.

    Attributes:
        image: (3, IMAGE_PX, IMAGE_PX) float32, normalised.
        points_mm: (N, 3), of the photo in the frame of the camera, of a view in that of the model.
        chosen: (N,) which pixel of the crop shows each point, row by row.
    """

    image: np.ndarray
    points_mm: np.ndarray
    chosen: np.ndarray


def crop_observation(
    photo: np.ndarray, depth_mm: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray, diameter_mm: float, rng: np.random.Generator
) -> PointCrop | None:
    """What a photo shows of an object; None where too little of it was measured.

    Args:
        photo: (height, width, 3) uint8.
        depth_mm: (height, width) measured, 0 where there is none.
        mask: (height, width) bool.
        intrinsics: (3, 3) BOP's K.
        diameter_mm: of the object.
        rng: draws the points.
    """
    mask = mask & (depth_mm > 0)
    if mask.sum() <= LEAST_POINTS:
        return None
    rows, columns = np.indices(mask.shape)
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(intrinsics).T
    points = rays * depth_mm[..., None]
    window = square_around(mask)
    inside = mask[window]
    middle = points[window][inside].mean(0)
    inside = inside & (np.linalg.norm(points[window] - middle, axis=-1) < NEAR_DIAMETERS * diameter_mm)
    if inside.sum() < LEAST_POINTS:
        return None
    return _crop(photo, mask, window, points[window], inside, OBSERVED_POINTS, rng)


def crop_view(views: Templates, index: int, rng: np.random.Generator) -> PointCrop:
    """What a view shows of its model."""
    depth_mm, pose = views.depths_mm[index], views.camera_from_model[index]
    mask = depth_mm > 0
    rows, columns = np.indices(mask.shape) + HALF_PX
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(views.intrinsics).T
    points = transform_points(rays * depth_mm[..., None], np.linalg.inv(pose))
    window = square_around(mask)
    return _crop(views.colors[index], mask, window, points[window], mask[window], VIEW_POINTS, rng)


def square_around(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the square around a mask, moved into the image where it would leave it."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    ends = [(line[0], line[-1] + 1) for line in (rows, columns)]
    half = min(max(end - start for start, end in ends), *mask.shape) // 2
    window = []
    for (start, end), length in zip(ends, mask.shape, strict=True):
        first = min(max((start + end) // 2 - half, 0), length - 2 * half)
        window.append(slice(int(first), int(first + 2 * half)))
    return window[0], window[1]


def _crop(
    photo: np.ndarray,
    mask: np.ndarray,
    window: tuple[slice, slice],
    points: np.ndarray,
    inside: np.ndarray,
    count: int,
    rng: np.random.Generator,
) -> PointCrop:
    """`count` of the points (side, side, 3) that are `inside`, some of them again where there are fewer."""
    # The published network is fed blue, green and red in this order, but with the means of red, green and blue.
    cut = np.ascontiguousarray((photo[..., ::-1] * mask[..., None])[window])
    image = cv2.resize(cut, (IMAGE_PX, IMAGE_PX), interpolation=cv2.INTER_LINEAR)
    image = ((image / 255 - MEAN) / DEVIATION).astype(np.float32).transpose(2, 0, 1)
    there = np.flatnonzero(inside)
    drawn = rng.choice(there, count, replace=len(there) <= count)
    rows, columns = np.divmod(drawn, inside.shape[1])
    scale = IMAGE_PX / inside.shape[0]
    chosen = np.floor(rows * scale).astype(np.int64) * IMAGE_PX + np.floor(columns * scale).astype(np.int64)
    return PointCrop(image, points.reshape(-1, 3)[drawn], chosen)
