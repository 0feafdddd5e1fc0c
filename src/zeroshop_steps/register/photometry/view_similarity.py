"""How well two views of an object show the same along its visual hull: in place, with some play, and at other depths.

The hull fills what is hollow, so that patches may lie deeper. Plain paint, shading and edges look alike in wrong places, too: that views
show something else is judged by distinctive patches, which lie within the object and are found nowhere else on it.
"""

import cv2
import numpy as np

from zeroshop_steps.register.photometry.hull_views import SmallView
from zeroshop_steps.register.photometry.score import LEAST_CONTRAST, WHOLE, compare_patches, measure_chance
from zeroshop_steps.register.photometry.transfer import Carry, carry_along_hull, carry_in_place

PATCH_PX, PLAY_PX = 13, 6  # of the small copies: what is compared, and how far it may lie beside its place
LEAST_PATCHES = 15  # of a pair that is judged
NEAREST, FARTHEST = -0.1, 1.2  # depths that are tried, from the hull's front, in radii of the object
DEPTH_STEP_PX = 1.5  # between them, in the neighbour
UNLIKE_SCORE = 0.6  # a patch that is found with less is not there
RIM_PX = 3  # of the small copies: a patch so near to an outline tells nothing that the outlines did not
CHANCE = 0.1  # nor does one that more than this share of the object has the like of

Chances = dict[tuple[int, int], float]
"""Of the patches of one view by their places (row, column) in its small copy: see `measure_chance`."""


def compare(one: SmallView, other: SmallView, radius: float) -> float | None:
    """How well the patches of a view are found in another, from -1 to 1: the median patch. None where too few are seen in both."""
    in_place = compare_in_place(one, other, radius)
    found = [float(np.median(in_place))] if len(in_place) >= LEAST_PATCHES else []
    at_depths = _compare_at_depths(one, other, carry_along_hull(one, other), radius)
    found += [] if at_depths is None else [at_depths]
    return max(found) if found else None


def compare_in_place(one: SmallView, other: SmallView, radius: float) -> np.ndarray:
    """(P,) scores of the patches that both see, along the hull's front."""
    carried, seen = carry_in_place(one, other, radius)
    whole = cv2.boxFilter(seen.astype(np.float32), -1, (PATCH_PX, PATCH_PX)) >= WHOLE
    return compare_patches(one.grey, carried, whole, PATCH_PX, PLAY_PX)


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


def compare_distinctive(one: SmallView, other: SmallView, radius: float, chances: Chances) -> np.ndarray:
    """(P,) scores of the patches that both see, and that tell places of the object apart; the one's chances are completed in place."""
    carried, seen = carry_in_place(one, other, radius)
    own = _find_whole(one.mask)

    def tells(patch: np.ndarray, row: int, column: int) -> bool:
        if (row, column) not in chances:
            chances[row, column] = measure_chance(one.grey, own, patch, row, column, PLAY_PX, UNLIKE_SCORE)
        return chances[row, column] <= CHANCE

    return compare_patches(one.grey, carried, own & _find_whole(seen), PATCH_PX, PLAY_PX, tells)


def _find_whole(seen: np.ndarray) -> np.ndarray:
    """(H, W) bool, where a patch, and `RIM_PX` around it, is wholly seen."""
    around = np.ones((PATCH_PX + 2 * RIM_PX,) * 2, np.uint8)
    whole: np.ndarray = cv2.erode(seen.astype(np.uint8), around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return whole > 0
