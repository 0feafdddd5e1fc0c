"""Small copies of the views of an object, with the front of its visual hull in each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, make_transform
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.observation.visual_hull import COARSE_VOXELS, VisualHull, voxel_centres
from zeroshop_steps.register.silhouettes.coherence import bound_object

NEAR_SCALE = 1.5  # neighbours' distances to the object differ by at most this factor
OBJECT_PX, BORDER_PX = 160, 8  # longer side of the object in the small copies that are compared, and what is kept around it
MISSING_SHARE = 0.05  # of the views whose masks may lack a part of the object


@dataclass(frozen=True)
class SmallView:
    """The object in a view: its camera, (H, W) bool mask and float32 grey, and (H, W) depth of the hull's front, 0 where there is none."""

    camera: Camera
    mask: np.ndarray
    grey: np.ndarray
    depth: np.ndarray


def make_small_views(views: Sequence[View], near_deg: float) -> tuple[dict[int, SmallView], list[tuple[int, int, float]], float]:
    """Small copies of the views that have neighbours, the pairs of these, and the radius of the object."""
    cameras, masks = [view.camera for view in views], [view.mask() for view in views]
    centre, radius = bound_object(cameras, masks)
    pairs = _find_neighbours(cameras, centre, near_deg)
    if not pairs:
        return {}, [], radius
    to_centre = make_transform(np.eye(3), -centre)
    centred = [transform_camera(camera, to_centre) for camera in cameras]
    allowed = max(1, round(MISSING_SHARE * len(views)))
    hull = voxel_centres(radius, COARSE_VOXELS)[VisualHull.carve(centred, masks, radius, COARSE_VOXELS, allowed).occupied.ravel()]
    needed = sorted({view for one, other, _ in pairs for view in (one, other)})
    return {view: _shrink(centred[view], masks[view], views[view].image(), hull, radius) for view in needed}, pairs, radius


def _find_neighbours(cameras: Sequence[Camera], centre: np.ndarray, near_deg: float) -> list[tuple[int, int, float]]:
    """Pairs of views (one, other) that are neighbours, and the angle between their directions, in degrees."""
    looks = np.array([camera.centre_in_world for camera in cameras]) - centre
    distances = np.linalg.norm(looks, axis=1)
    angles = np.degrees(np.arccos(np.clip((looks @ looks.T) / np.outer(distances, distances), -1, 1)))
    near = (angles <= near_deg) & (np.abs(np.log(distances[:, None] / distances[None])) <= np.log(NEAR_SCALE))
    return [(int(one), int(other), float(angles[one, other])) for one, other in np.argwhere(np.triu(near, 1))]


def _shrink(camera: Camera, mask: np.ndarray, image: np.ndarray, hull: np.ndarray, radius: float) -> SmallView:
    """The object in a view, at `OBJECT_PX`."""
    rows, columns = np.nonzero(mask)
    scale = OBJECT_PX / (max(np.ptp(rows), np.ptp(columns)) + 1)
    corner = np.array([columns.min(), rows.min()]) * scale - BORDER_PX
    width_px, height_px = (int((np.ptp(side) + 1) * scale) + 2 * BORDER_PX for side in (columns, rows))
    to_small = np.array([[scale, 0.0, -corner[0]], [0.0, scale, -corner[1]], [0.0, 0.0, 1.0]])
    grey: np.ndarray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    if scale < 1:
        grey = cv2.GaussianBlur(grey, (0, 0), 0.5 / scale)
    # Pixel centres lie at half coordinates in cameras, at whole ones for OpenCV.
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    warp = (np.linalg.inv(half) @ to_small @ half)[:2]
    small_mask = cv2.warpAffine(mask.astype(np.float32), warp, (width_px, height_px)) > 0.5
    small = replace(camera, width_px=width_px, height_px=height_px, intrinsics=to_small @ camera.intrinsics)
    return SmallView(small, small_mask, cv2.warpAffine(grey, warp, (width_px, height_px)), _find_front(small, small_mask, hull, radius))


def _find_front(camera: Camera, mask: np.ndarray, hull: np.ndarray, radius: float) -> np.ndarray:
    """(H, W) depth of the front of the hull, whose voxels have their centres at (P, 3) `hull`; 0 where there is none."""
    rows, columns, depth, seen = camera.find_pixels(hull)
    nearest: np.ndarray = np.full(mask.shape, np.inf, np.float32)
    np.minimum.at(nearest, (rows[seen], columns[seen]), depth[seen])
    half_px = int(np.ceil(radius / COARSE_VOXELS * camera.intrinsics[0, 0] / camera.camera_from_world[2, 3]))  # of a voxel's side
    nearest = cv2.erode(nearest, np.ones((2 * half_px + 1,) * 2, np.uint8))
    return np.where(mask & np.isfinite(nearest), nearest, 0.0)
