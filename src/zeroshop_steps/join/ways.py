"""Ways in which a pass may lie to another: similarities that its matched points, or the outlines alone, support.

An object with the same print on two sides has matches that support two ways. All that enough matches support are found, one after the
other; appearance selects the right one (`evidence`).
"""

from dataclasses import dataclass

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import to_matrix
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.join.object_matches import PointPairs

NEAR_SIZES = 0.02  # a pair of points supports a way if it lies this close, in sizes of the cloud of points
FEWEST_PAIRS = 12  # of points that must support a way
LEAST_SHARE = 0.2  # of the pairs of the best way: fewer support chance
MOST_WAYS = 4
SCALES = (1 / 8, 8.0)  # of one pass to another; beyond, a way is degenerate
FLAT_SHARE = 0.02  # smallest extent of the supporting points over their largest: points on a line leave a turn open


@dataclass(frozen=True)
class Way:
    """One way.

    Attributes:
        target_from_source: (4, 4) similarity.
        pairs: how many pairs of points support it.
    """

    target_from_source: np.ndarray
    pairs: int


def find_ways_by_matches(pairs: PointPairs, seed: int) -> list[Way]:
    """The ways that matched points support, the best supported first (RANSAC, again and again without the pairs explained before)."""
    ways: list[Way] = []
    left = np.ones(len(pairs.target), bool)
    size = float(np.linalg.norm(pairs.target.std(0))) * np.sqrt(12.0) if len(pairs.target) else 0.0
    options = pycolmap.RANSACOptions()
    options.max_error, options.random_seed = NEAR_SIZES * size, seed
    while len(ways) < MOST_WAYS and left.sum() >= FEWEST_PAIRS:
        fitted = pycolmap.estimate_sim3d_robust(pairs.source[left], pairs.target[left], options)
        if fitted is None:
            break
        way = to_matrix(fitted["tgt_from_src"])
        near = np.linalg.norm(transform_points(pairs.source, way) - pairs.target, axis=1) <= options.max_error
        supporting = int((near & left).sum())
        if supporting < max(FEWEST_PAIRS, LEAST_SHARE * (ways[0].pairs if ways else 0)):
            break
        left &= ~near
        if SCALES[0] < compute_scale(way) < SCALES[1] and not _is_line(pairs.target[near]):
            ways.append(Way(way, supporting))
    return ways


def _is_line(points: np.ndarray) -> bool:
    """Whether points lie on a line, nearly."""
    extents = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(extents[1] < FLAT_SHARE * extents[0])
