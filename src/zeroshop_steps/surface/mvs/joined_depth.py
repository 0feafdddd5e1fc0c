"""Join given depth with that of stereo, each by its uncertainty.

A given depth is believed where another view measured the same, by either means, and no others look through it (Merrell et al. 2007). Where
both means agree in a pixel, the mean counts, weighted by the inverse variances; where they contradict each other, the one that more
views support. What the neighbouring views measured of the same spot then lowers the noise.

Lengths are in normalized units, as in depth_consistency.py.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.mvs.depth_maps import find_gaps, look_up_depths, unproject
from zeroshop_steps.surface.mvs.given_depth import GivenDepth
from zeroshop_steps.surface.mvs.patchmatch import select_neighbours

CHECKED_VIEWS = 8
"""Neighbouring views whose depths are compared with those of a view."""
STEREO_DEVIATION = 0.003
"""Standard deviation of stereo's confirmed depths: a third of the difference at which they agree."""
DEVIATION_MAX = 0.02
"""Depths that are less sure than this, 1 % of the object's size, measure no surface; they still give the scale."""
AGREEING_DEVIATIONS = 3.0
"""Two depths agree within this many standard deviations of their difference."""
CONTRADICTION_GAP = 0.03
"""How far behind a depth other views must have found surface to contradict it, so that a depth that is only inexact contradicts nothing:
three times the difference at which stereo's agree, or twice `AGREEING_DEVIATIONS` where that is more."""
CONTRADICTING_VIEWS_MIN = 2
"""A depth is dropped when so many views have found surface behind it."""


@dataclass(frozen=True)
class JoinedDepth:
    """What both means measured.

    Attributes:
        depths: for each view, (H, W) float32, 0 where nothing is known.
        weights: (H, W) float32 how much each counts in training: 1 for what is as sure as stereo's, less for what is less sure.
        figures: numbers of pixels, for stereo.json.
    """

    depths: list[np.ndarray]
    weights: list[np.ndarray]
    figures: dict[str, int]


def join_depths(cameras: Sequence[Camera], stereo: Sequence[np.ndarray], given: GivenDepth) -> JoinedDepth:
    """Join the confirmed depths of stereo, (H, W) of each view and 0 where there are none, with given ones."""
    sure = [np.where(deviation <= DEVIATION_MAX, depth, 0.0) for depth, deviation in zip(given.depths, given.deviations, strict=True)]
    by_stereo = [np.where(depth > 0, np.float32(STEREO_DEVIATION), np.float32(0)) for depth in stereo]
    sources = [_Source(list(stereo), by_stereo), _Source(sure, given.deviations)]
    neighbours = select_neighbours(list(cameras), min(CHECKED_VIEWS, len(cameras) - 1))
    depths, deviations, added, refused, contradicting = [], [], 0, 0, 0
    for index in range(len(cameras)):
        support = [_count_support(index, own, cameras, sources, neighbours[index]) for own in sources]
        through = _count_contradictions(index, sources[1], cameras, sources)
        believed = np.where((support[1] > 0) & (through < CONTRADICTING_VIEWS_MIN), sure[index], 0.0)
        depth, deviation, conflict = combine(stereo[index], by_stereo[index], believed, given.deviations[index], support[0], support[1])
        depths.append(depth)
        deviations.append(deviation)
        added += int(((depth > 0) & (stereo[index] == 0)).sum())
        refused += int(((sure[index] > 0) & (believed == 0)).sum())
        contradicting += int(conflict.sum())
    averaged, weights = [], []
    for index in range(len(cameras)):
        depth, deviation = _average_over_views(index, _Source(depths, deviations), cameras, neighbours[index])
        averaged.append(depth)
        weights.append(np.where(depth > 0, np.minimum(STEREO_DEVIATION / np.maximum(deviation, 1e-9), 1.0), 0.0).astype(np.float32))
    pixels = sum(int((depth > 0).sum()) for depth in sure)
    figures = {"measured_pixels": pixels, "added_pixels": added, "refused_pixels": refused, "conflicting_pixels": contradicting}
    return JoinedDepth(averaged, weights, figures)


def combine(
    first: np.ndarray, first_deviation: np.ndarray, second: np.ndarray, second_deviation: np.ndarray, first_support: np.ndarray,
    second_support: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Two measurements of the same depths as one: the mean weighted by inverse variances, and its standard deviation.

    Args:
        first, second: depths, 0 where unknown; with them their standard deviations, and how many views support each.

    Returns:
        depth and deviation, float32, 0 where unknown; and a bool array, where both contradict each other: the better supported one
        stays there, and neither where the support is equal.
    """
    both = (first > 0) & (second > 0)
    w1 = np.where(first > 0, 1.0 / np.maximum(first_deviation, 1e-9) ** 2, 0.0)
    w2 = np.where(second > 0, 1.0 / np.maximum(second_deviation, 1e-9) ** 2, 0.0)
    conflict = both & (np.abs(first - second) > AGREEING_DEVIATIONS * np.hypot(first_deviation, second_deviation))
    w1 = np.where(conflict & (first_support <= second_support), 0.0, w1)
    w2 = np.where(conflict & (second_support <= first_support), 0.0, w2)
    total = w1 + w2
    known = total > 0
    divisor = np.where(known, total, 1.0)
    depth = np.where(known, (w1 * first + w2 * second) / divisor, 0.0).astype(np.float32)
    return depth, np.where(known, divisor**-0.5, 0.0).astype(np.float32), conflict


class _Source(NamedTuple):
    """Depths of all views by one means, and their standard deviations."""

    depths: list[np.ndarray]
    deviations: list[np.ndarray]


def _count_support(index: int, own: _Source, cameras: Sequence[Camera], sources: Sequence[_Source], checked: Sequence[int]) -> np.ndarray:
    """(H, W) how many checked views measured the same as a view, by any of the sources."""
    depth, points, y, x = _unproject_known(index, own, cameras)
    count = np.zeros(len(y), int)
    for other in checked:
        agrees = np.zeros(len(y), bool)
        for source in sources:
            gap, deviation = _find_gaps(other, source, cameras, points)
            agrees |= np.abs(gap) <= AGREEING_DEVIATIONS * np.hypot(deviation, own.deviations[index][y, x])
        count += agrees
    return _spread(depth, y, x, count)


def _count_contradictions(index: int, own: _Source, cameras: Sequence[Camera], sources: Sequence[_Source]) -> np.ndarray:
    """(H, W) how many views have found surface behind a view's depth, by any of the sources."""
    depth, points, y, x = _unproject_known(index, own, cameras)
    count = np.zeros(len(y), int)
    for other in range(len(cameras)):
        behind = np.zeros(len(y), bool)
        for source in sources:
            gap, deviation = _find_gaps(other, source, cameras, points)
            unsure = np.hypot(deviation, own.deviations[index][y, x])
            behind |= gap > np.maximum(CONTRADICTION_GAP, 2 * AGREEING_DEVIATIONS * unsure)
        count += behind
    return _spread(depth, y, x, count)


def _average_over_views(index: int, own: _Source, cameras: Sequence[Camera], checked: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """A view's depths, moved by the weighted mean of their gaps to those that neighbouring views agree on, and their deviations."""
    depth, points, y, x = _unproject_known(index, own, cameras)
    unsure = own.deviations[index][y, x]
    weight, moved = 1.0 / unsure**2, np.zeros(len(y))
    for other in checked:
        gap, deviation = _find_gaps(other, own, cameras, points)
        agrees = np.abs(gap) <= AGREEING_DEVIATIONS * np.hypot(deviation, unsure)
        its_weight = np.where(agrees, 1.0 / np.maximum(deviation, 1e-9) ** 2, 0.0)
        moved += its_weight * np.where(agrees, gap, 0.0)
        weight += its_weight
    return _spread(depth, y, x, depth[y, x] + moved / weight), _spread(depth, y, x, weight**-0.5)


def _unproject_known(index: int, own: _Source, cameras: Sequence[Camera]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A view's depth map, the (P, 3) points that it shows, and their rows and columns."""
    depth = own.depths[index]
    y, x = np.nonzero(depth)
    return depth, unproject(cameras[index], depth, y, x), y, x


def _find_gaps(index: int, source: _Source, cameras: Sequence[Camera], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P,) how far a view's depth lies behind each of (P, 3) points, NaN where it has none, and (P,) its deviation there, 0 without."""
    deviation = np.zeros(len(points))
    framed, found, _ = look_up_depths(cameras[index], source.deviations[index], points)
    deviation[framed] = found
    return find_gaps(cameras[index], source.depths[index], points), deviation


def _spread(depth: np.ndarray, y: np.ndarray, x: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(H, W) float32 of values at pixels in rows y and columns x, 0 elsewhere."""
    result = np.zeros(depth.shape, np.float32)
    result[y, x] = values
    return result
