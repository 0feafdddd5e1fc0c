"""Compare the pictures of neighbouring views patch by patch: views of sides that look alike, laid onto each other, differ in detail.

Sides with nearly the same print, as the two of a can, agree in matches, masks and reprojection errors, and a cylinder's masks fit any turn.
But views from nearly one direction must show the same all over. Each view is carried into its neighbours along the visual hull of the
masks, and textured patches are compared by normalized cross-correlation: in place, with some play, and at other depths, since the hull
fills what is hollow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.transforms import transform_camera
from zeroshop_steps.geometry.visual_hull import find_inside_masks, voxel_centres
from zeroshop_steps.register.pair_pictures import compare_patches
from zeroshop_steps.register.silhouette_coherence import bound_object
from zeroshop_steps.register.strange_sides import make_refusal

NEAR_DEG, NEAR_SCALE = 18.0, 1.5
"""Views are neighbours where their directions to the object differ by at most so much, and their distances by at most this factor."""
LEAST_SCORE, SCORE_PER_DEG = 0.92, 0.007
"""Neighbours in one direction should agree to this score, those an angle apart to as much less. Right models: 0.9 and more within 10
degrees, 0.85 and more up to 18, for hollow things 0.8; sides that look alike 0.55 to 0.84."""
OBJECT_PX, BORDER_PX = 160, 8  # longer side of the object in the small copies that are compared, and what is kept around it
VOXELS = 96  # along each edge of the hull
MISSING_SHARE = 0.05  # of the views whose masks may lack a part of the object
PATCH_PX, PLAY_PX = 13, 6  # of the small copies: what is compared, and how far it may lie beside its place
LEAST_CONTRAST = 5.0  # standard deviation of a patch's grey, of 255
LEAST_PATCHES = 15  # of a pair that is judged
NEAREST, FARTHEST = -0.1, 1.2  # depths that are tried, from the hull's front, in radii of the object
DEPTH_STEP_PX = 1.5  # between them, in the neighbour
VISIBLE = 0.06  # of the radius: how near to the hull's front in the neighbour a point lies that it sees
WHOLE = 0.95  # share of a patch that must be on the object in both
WRONG_SHARE = 0.25
"""Of the pairs of neighbours that are judged, this share may disagree: up to 0.05 in right models, 0.5 to 1 in wrong ones. Where few are
judged, none of them is excused: a tube of which half of the views were taken came out folded, 284 mm off, with two of two that disagree."""

Carry = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SmallView:
    """The object in a view: its camera, (H, W) bool mask and float32 grey, and (H, W) depth of the hull's front, 0 where there is none."""

    camera: Camera
    mask: np.ndarray
    grey: np.ndarray
    depth: np.ndarray


def check_neighbours(views: Sequence[View], figures: dict[str, Any], model: pycolmap.Reconstruction) -> None:
    """Refuse cameras whose neighbouring views of the object do not show the same.

    Args:
        views: the registered views, with masks.
        figures: the record so far; completed in place.
        model: goes with the refusal.

    Raises:
        RegistrationFailed: too many neighbours disagree.
    """
    judged, disagreeing = find_disagreeing(views)
    figures |= {"compared_neighbours": judged, "disagreeing": [list(pair) for pair in disagreeing]}
    if len(disagreeing) > WRONG_SHARE * judged:
        raise make_refusal(disagreeing, judged, "differ in detail", figures, model)


def find_disagreeing(views: Sequence[View]) -> tuple[int, list[tuple[str, str]]]:
    """How many pairs of neighbours were judged, and the stems of those whose pictures do not show the same.

    Args:
        views: the registered views, with masks.
    """
    small, pairs, radius = make_small_views(views, NEAR_DEG)
    judged, disagreeing = 0, []
    for one, other, angle_deg in pairs:
        scores = [score for score in (compare(small[a], small[b], radius) for a, b in ((one, other), (other, one))) if score is not None]
        if not scores:
            continue
        judged += 1
        if np.mean(scores) < LEAST_SCORE - SCORE_PER_DEG * angle_deg:
            disagreeing.append((Path(views[one].camera.name).stem, Path(views[other].camera.name).stem))
    return judged, disagreeing


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
    hull = find_inside_masks(voxel_centres(radius, VOXELS), centred, masks, allowed).reshape((VOXELS,) * 3)
    needed = sorted({view for one, other, _ in pairs for view in (one, other)})
    return {view: _shrink(centred[view], masks[view], views[view].image(), hull, radius) for view in needed}, pairs, radius


def _make_carry(one: SmallView, other: SmallView) -> Carry:
    """What carries what another view shows into this one, along the hull's front or behind it."""
    rows, columns = np.nonzero(one.depth > 0)
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], 1) @ np.linalg.inv(one.camera.intrinsics).T
    world_from_camera = np.linalg.inv(one.camera.camera_from_world)

    def carry(values: np.ndarray, behind: float) -> tuple[np.ndarray, np.ndarray]:
        """(H, W) what another view holds at the places of this one's pixels, and the (P,) depths there."""
        points = (rays * (one.depth[rows, columns] + behind)[:, None]) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        pixels, depth = other.camera.project(points)
        places = np.full((*one.depth.shape, 2), -1e3, np.float32)
        places[rows, columns] = pixels - 0.5
        return cv2.remap(values, places[..., 0], places[..., 1], cv2.INTER_LINEAR), depth

    return carry


def compare(one: SmallView, other: SmallView, radius: float) -> float | None:
    """How well the patches of a view are found in another, from -1 to 1: the median patch. None where too few are seen in both."""
    in_place = compare_in_place(one, other, radius)
    found = [float(np.median(in_place))] if len(in_place) >= LEAST_PATCHES else []
    at_depths = _compare_at_depths(one, other, _make_carry(one, other), radius)
    found += [] if at_depths is None else [at_depths]
    return max(found) if found else None


def compare_in_place(one: SmallView, other: SmallView, radius: float) -> np.ndarray:
    """(P,) scores of the patches that both see, along the hull's front."""
    carried, seen = carry_in_place(one, other, radius)
    whole = cv2.boxFilter(seen.astype(np.float32), -1, (PATCH_PX, PATCH_PX)) >= WHOLE
    return compare_patches(one.grey, carried, whole, PATCH_PX, PLAY_PX, LEAST_CONTRAST)


def carry_in_place(one: SmallView, other: SmallView, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) what another view shows, carried into this one along the hull's front, and bool where both see the hull."""
    carry = _make_carry(one, other)
    carried, depth = carry(other.grey, 0.0)
    front, _ = carry(other.depth.astype(np.float32), 0.0)
    seen = one.depth > 0
    seen[seen] = np.abs(front[seen] - depth) < VISIBLE * radius
    return carried, seen


def _compare_at_depths(one: SmallView, other: SmallView, carry: Carry, radius: float) -> float | None:
    def average(values: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(values, -1, (PATCH_PX, PATCH_PX))

    mean = average(one.grey)
    variance = average(one.grey**2) - mean**2
    judged = (average((one.depth > 0).astype(np.float32)) >= WHOLE) & (variance >= LEAST_CONTRAST**2)
    best, seen = np.full(one.depth.shape, -1.0), np.zeros(one.depth.shape, bool)
    for behind in np.linspace(NEAREST, FARTHEST, _count_depths(one, other, radius)) * radius:
        carried, _ = carry(other.grey, behind)
        on_object = judged & (average(carry(other.mask.astype(np.float32), behind)[0]) >= WHOLE)
        other_mean = average(carried)
        other_variance = average(carried**2) - other_mean**2
        score = (average(one.grey * carried) - mean * other_mean) / np.sqrt(np.maximum(variance * other_variance, 1e-3))
        best[on_object] = np.maximum(best, score)[on_object]
        seen |= on_object
    step = PATCH_PX // 2 + 1
    scores = best[::step, ::step][seen[::step, ::step]]
    return float(np.median(scores)) if len(scores) >= LEAST_PATCHES else None


def _count_depths(one: SmallView, other: SmallView, radius: float) -> int:
    """So many depths that the object's centre moves by `DEPTH_STEP_PX` from one to the next in the other view."""
    direction = one.camera.camera_from_world[2, :3]
    ends, _ = other.camera.project(np.array([NEAREST, FARTHEST])[:, None] * radius * direction)
    return 2 + int(np.linalg.norm(ends[1] - ends[0]) / DEPTH_STEP_PX)


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
