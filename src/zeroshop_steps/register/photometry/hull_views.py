"""Small copies of the views of an object, with the front of its visual hull in each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import transform_camera
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.register.silhouettes.coherence import bound_object

NEAR_SCALE = 1.5  # neighbours' distances to the object differ by at most this factor
OBJECT_PX, BORDER_PX = 160, 8  # longer side of the object in the small copies that are compared, and what is kept around it
VOXELS = 96  # along each edge of the hull
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
    to_centre = np.eye(4)
    to_centre[:3, 3] = -centre
    centred = [transform_camera(camera, to_centre) for camera in cameras]
    allowed = max(1, round(MISSING_SHARE * len(views)))
    hull = VisualHull.carve(centred, masks, radius, VOXELS, allowed).occupied
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
    """(H, W) depth of the first voxel of the hull along each ray; 0 where there is none."""
    rows, columns = np.nonzero(mask)
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], 1) @ np.linalg.inv(camera.intrinsics).T
    world_from_camera = np.linalg.inv(camera.camera_from_world)
    per_length = VOXELS / (2 * radius)
    steps, start = per_length * rays @ world_from_camera[:3, :3].T, per_length * world_from_camera[:3, 3] + VOXELS / 2
    middle = camera.camera_from_world[2, 3]
    tried = np.linspace(middle - radius, middle + radius, 2 * VOXELS)
    at, last = _find_depths_in_box(hull, steps, start, tried)
    solid = np.pad(hull, 2)  # so that what lies outside is empty
    strides = np.array(solid.strides) // solid.itemsize
    found, left = np.zeros(len(rows)), np.flatnonzero(at <= last)
    at, last, steps = at[left], last[left], steps[left]
    while len(left):
        depth = tried[at]
        index = np.floor(steps * depth[:, None] + start).astype(np.int32) + 2
        hit = solid.ravel()[index @ strides]
        found[left[hit]] = depth[hit]
        on = ~hit & (at < last)
        at, last, steps, left = at[on] + 1, last[on], steps[on], left[on]
    depths = np.zeros(mask.shape)
    depths[rows, columns] = found
    return depths


def _find_depths_in_box(hull: np.ndarray, steps: np.ndarray, start: np.ndarray, depths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P,) indices of the first and the last of sorted depths at which rays are in the box around the hull, or half a voxel beside it.

    Args:
        hull: (V, V, V) bool.
        steps, start: (P, 3) and (3,): a ray is at `steps * depth + start`, in voxels.
        depths: (D,); the last index is below the first where none is in the box.
    """
    if not hull.any():
        return np.ones(len(steps), int), np.zeros(len(steps), int)
    held = [np.flatnonzero(hull.any(axis=others)) for others in ((1, 2), (0, 2), (0, 1))]
    sides = [np.array([along[0] - 0.5 for along in held]), np.array([along[-1] + 1.5 for along in held])]
    ends = np.stack([(side - start) / np.where(steps == 0, 1e-12, steps) for side in sides])
    first, last = ends.min(0).max(1), ends.max(0).min(1)
    return np.searchsorted(depths, first), np.searchsorted(depths, last, "right") - 1
