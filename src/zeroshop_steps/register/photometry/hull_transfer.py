"""Carry what one view shows into another along the visual hull, and compare both patch by patch."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.register.photometry.hull_views import SmallView
from zeroshop_steps.register.photometry.patches import compare_patches

PATCH_PX, PLAY_PX = 13, 6  # of the small copies: what is compared, and how far it may lie beside its place
LEAST_CONTRAST = 5.0  # standard deviation of a patch's grey, of 255
LEAST_PATCHES = 15  # of a pair that is judged
NEAREST, FARTHEST = -0.1, 1.2  # depths that are tried, from the hull's front, in radii of the object
DEPTH_STEP_PX = 1.5  # between them, in the neighbour
VISIBLE = 0.06  # of the radius: how near to the hull's front in the neighbour a point lies that it sees
WHOLE = 0.95  # share of a patch that must be on the object in both


Carry = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]


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
