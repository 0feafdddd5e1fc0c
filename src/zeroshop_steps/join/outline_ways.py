"""Ways in which a pass may lie to another by the outlines alone, where print does not tell: plain objects.

Between two passes the object was turned over, so nothing about its turn is known. All turns are tried coarsely, the best are refined,
and all ways that differ are returned: one that is far better than every other shows how the object lies; a bowl has as many as one likes.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.join.ways import MOST_WAYS
from zeroshop_steps.register.submodels.outline_alignment import (
    CameraGroup,
    Hypothesis,
    keep_distinct,
    lay,
    make_frame,
    measure_misses,
    refine,
)

AXES, ANGLES = 200, 24  # of the turns that are tried: 15 degrees apart
COARSE_VIEWS, COARSE_RAYS, COARSE_POINTS, FARTHEST_PX = 8, 160, 6, 200.0  # of the thinned groups
NEAR_DEG, TRIED = 20.0, 60  # best turns that are refined coarsely, so far from each other
COARSE_STEP, COARSE_LOSS_PX, COARSE_EVALUATIONS = 1e-2, 5.0, 12
REFINED = 6  # of the ways that are found coarsely


def find_ways_by_outlines(target: CameraGroup, source: CameraGroup) -> list[Hypothesis]:
    """The likeliest ways to lay the source to the target, the best first; each refined, and each a turn apart from the others."""
    few = _thin(target), _thin(source)
    turns = make_turns()
    # Single ones take three times as long, and very many do not fit into the processor's cache.
    parts = np.array_split(turns, -(-len(turns) // 16))
    costs = np.concatenate([measure_misses(*few, lay(*few, part)).mean(-1) for part in parts])
    starts = [lay(*few, turns[one]) for one in _choose_apart(turns, costs)]
    found = _refine_coarsely(few, starts)
    # What is nearly its own mirror image or half turn fits nearly as well so, however few of the turns above begin near it.
    found = keep_distinct(found + _refine_coarsely(few, [found[0].target_from_source @ turn for turn in _make_half_turns(source)]))
    return keep_distinct([refine(target, source, one.target_from_source) for one in found[:REFINED]])[:MOST_WAYS]


def _thin(group: CameraGroup) -> CameraGroup:
    return group.thin(COARSE_VIEWS, COARSE_RAYS, COARSE_POINTS, FARTHEST_PX)


def make_turns() -> np.ndarray:
    """(AXES * ANGLES, 3, 3) rotations, evenly spread: axes on a Fibonacci sphere, each turned about."""
    height = 1 - (2 * np.arange(AXES) + 1) / AXES
    around = np.pi * (1 + np.sqrt(5)) * (np.arange(AXES) + 0.5)
    axes = np.stack([np.cos(around) * np.sqrt(1 - height**2), np.sin(around) * np.sqrt(1 - height**2), height], axis=1)
    spins = Rotation.from_rotvec(np.outer(np.arange(ANGLES) * 2 * np.pi / ANGLES, [0, 0, 1])).as_matrix()
    return np.concatenate([make_frame(axis) @ spins for axis in axes])


def _choose_apart(turns: np.ndarray, costs: np.ndarray) -> list[int]:
    """Indices of the best turns, each `NEAR_DEG` and more from those before."""
    chosen: list[int] = []
    for one in np.argsort(costs, kind="stable"):
        traces = np.einsum("nij,ij->n", turns[chosen], turns[one])  # 1 + 2 cos of the angle between
        if not (traces > 1 + 2 * np.cos(np.radians(NEAR_DEG))).any():
            chosen.append(int(one))
        if len(chosen) == TRIED:
            break
    return chosen


def _refine_coarsely(few: tuple[CameraGroup, CameraGroup], starts: list[np.ndarray]) -> list[Hypothesis]:
    found = [refine(*few, start, COARSE_STEP, COARSE_LOSS_PX, COARSE_EVALUATIONS) for start in starts]
    return sorted(found, key=lambda hypothesis: hypothesis.miss_px)


def _make_half_turns(group: CameraGroup) -> list[np.ndarray]:
    """(4, 4) half and quarter turns about the principal axes of what the group's rays allow."""
    centre = group.points.mean(0)
    _, _, axes = np.linalg.svd(group.points - centre, full_matrices=False)
    turns = []
    for axis in axes:
        for quarter in (1, 2, 3):
            turn = Rotation.from_rotvec(axis * quarter * np.pi / 2)
            turns.append(make_transform(turn.as_matrix(), centre - turn.apply(centre)))
    return turns
