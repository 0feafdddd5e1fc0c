"""A plane sweep over heights above the ground (Collins 1996): which pixels of a photo lie on the ground, above it, or elsewhere.

A pixel of the ground looks alike in other photos if it is carried over by the ground's plane, one of the object by a plane above it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.segment.cues.points import NEAR
from zeroshop_steps.segment.ground_picture import find_homography

WIDTH_PX = 320  # photos are swept at this width at most; time grows with its square
HEIGHTS = np.linspace(-0.05, NEAR, 28)  # distances of the cameras; neighbouring planes differ by about three pixels
FLAT, RAISED = 0.012, 0.02  # heights up to which a pixel may be of the ground, and from which on it is not, likewise
NEIGHBOURS, ANGLES_DEG = 4, (4.0, 45.0)  # photos that each is compared with, and the angles between such, seen from the focus
WINDOW_PX, NOISE_LEVELS = 7, 4.0  # of the correlation; the noise keeps surfaces without print from correlating


@dataclass(frozen=True)
class SweptPhoto:
    """A photo as it is swept: grey, (h, w) float32, its camera, and its local mean and deviation."""

    grey: np.ndarray
    camera: Camera
    mean: np.ndarray
    deviation: np.ndarray


def shrink(image: np.ndarray, camera: Camera) -> SweptPhoto:
    """An (H, W, 3) float32 RGB image, 0 to 255, to be swept."""
    width = min(WIDTH_PX, camera.width_px)
    small = camera.resized(width, max(round(camera.height_px * width / camera.width_px), 1))
    grey = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (small.width_px, small.height_px), interpolation=cv2.INTER_AREA)
    return SweptPhoto(grey, small, *_measure_windows(grey))


def sweep(
    photos: Sequence[SweptPhoto], index: int, ground: SceneSupport, part: tuple[slice, slice] = (slice(None), slice(None))
) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) float32 each, 0 to 1: how well this part of a photo correlates with its neighbours by planes near the focus above the ground,
    and by all others: at the ground's height, below it, or far away."""
    own, others = _crop(photos[index], part), _choose_neighbours(photos, index, ground.focus)
    nearest, reach, rise, above = _measure_rays(own.camera, ground, NEAR * ground.distance)
    raised, elsewhere = np.zeros((2, *own.grey.shape), np.float32)
    for height in HEIGHTS * ground.distance:
        correlation = _correlate(own, others, ground, height)
        near = np.abs((height - above) / rise - nearest) < reach
        if height >= RAISED * ground.distance:
            np.maximum(raised, np.where(near, correlation, 0), out=raised)
        flat = height <= FLAT * ground.distance
        np.maximum(elsewhere, correlation if flat else np.where(near, 0, correlation), out=elsewhere)
    return raised, elsewhere


def _crop(photo: SweptPhoto, part: tuple[slice, slice]) -> SweptPhoto:
    (top, bottom, _), (left, right, _) = (rows.indices(length) for rows, length in zip(part, photo.grey.shape, strict=True))
    camera = photo.camera.cropped(left, top, right - left, bottom - top)
    return SweptPhoto(photo.grey[part], camera, photo.mean[part], photo.deviation[part])


def _measure_windows(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean, square = (cv2.blur(part, (WINDOW_PX,) * 2) for part in (grey, grey * grey))
    return mean, np.sqrt(np.maximum(square - mean * mean, 0) + NOISE_LEVELS**2)


def _choose_neighbours(photos: Sequence[SweptPhoto], index: int, focus: np.ndarray) -> list[SweptPhoto]:
    ways = np.array([photo.camera.centre_in_world - focus for photo in photos])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(ways @ ways[index], -1, 1)))
    inside = (angles > ANGLES_DEG[0]) & (angles < ANGLES_DEG[1])
    return [photos[other] for other in np.argsort(angles) if inside[other]][:NEIGHBOURS]


def _measure_rays(camera: Camera, ground: SceneSupport, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Of the ray of each pixel, (h, w): how far along it is the point nearest to the focus, and half its length in the ball of this radius
    around the focus; how fast it rises above the ground; and the camera's height."""
    x, y = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.camera_from_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    way = ground.focus - camera.centre_in_world
    nearest, rise = rays @ way, rays @ ground.normal
    reach = np.sqrt(np.maximum(radius**2 - way @ way + nearest**2, 0))
    return nearest, reach, np.where(np.abs(rise) < 1e-6, 1e-6, rise), float(ground.heights(camera.centre_in_world[None])[0])


def _correlate(own: SweptPhoto, others: Sequence[SweptPhoto], ground: SceneSupport, height: float) -> np.ndarray:
    """(h, w): normalized cross-correlation with other photos that are carried over by a plane, mean of the best two, as the object hides
    from some what is behind it."""
    world_from_plane = np.zeros((4, 3))
    world_from_plane[:3] = np.stack([*ground.axes(), ground.foot + height * ground.normal], 1)
    world_from_plane[3, 2] = 1
    plane_from_own = np.linalg.inv(find_homography(own.camera, world_from_plane))
    best = second = np.zeros(own.grey.shape, np.float32)
    for other in others:
        homography = find_homography(other.camera, world_from_plane) @ plane_from_own
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        carried = cv2.warpPerspective(other.grey, homography, own.grey.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
        mean, deviation = _measure_windows(carried)
        correlation = (cv2.blur(own.grey * carried, (WINDOW_PX,) * 2) - own.mean * mean) / (own.deviation * deviation)
        second = np.maximum(second, np.minimum(best, correlation))
        best = np.maximum(best, correlation)
    return np.asarray((best + second) / 2)
