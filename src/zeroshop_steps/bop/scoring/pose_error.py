"""The three pose errors of the BOP Challenge since 2019 (Hodan et al., BOP Challenge 2020, section 2.2).

MSSD is the maximum symmetry-aware surface distance, MSPD the maximum symmetry-aware projection distance, VSD the visible surface
discrepancy. Poses are camera_from_model in mm. In BOP's camera matrices, pixel centres are whole numbers.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from zeroshop_steps.bop.scoring.depth_render import DepthPatch

VSD_TAUS = np.arange(0.05, 0.51, 0.05)
"""Misalignment tolerances in diameters, as BOP defines them: 0.05 to 0.5."""


@dataclass(frozen=True)
class ModelPoints:
    """The vertices of a model in the order in which the errors need them.

    Attributes:
        hull: (H, 3) vertices of the convex hull. The distance between two poses of a point is convex in the point, so it is largest at
            one of them.
        spread: (V, 3) all vertices, those farthest from the centre first.
    """

    hull: np.ndarray
    spread: np.ndarray

    @classmethod
    def from_vertices(cls, vertices: np.ndarray) -> "ModelPoints":
        """From (V, 3) vertices in mm."""
        points = np.unique(vertices, axis=0)
        try:
            hull = points[ConvexHull(points).vertices]
        except QhullError:
            hull = points
        far = np.argsort(-np.linalg.norm(points - points.mean(0), axis=1), kind="stable")
        return cls(hull, points[far])


def mssd(estimated: np.ndarray, true: np.ndarray, points: ModelPoints, symmetries: np.ndarray) -> np.ndarray:
    """(N,) mm: largest distance of a vertex between (N, 4, 4) estimated and true poses; the least over the symmetries."""
    return _mssd(_top_rows(estimated), _top_rows(true), _top_rows(symmetries), np.ascontiguousarray(points.hull))


def mspd(estimated: np.ndarray, true: np.ndarray, intrinsics: np.ndarray, points: ModelPoints, symmetries: np.ndarray) -> np.ndarray:
    """(N,) px: largest distance of a projected vertex; the least over the symmetries. `intrinsics` are (N, 3, 3)."""
    matrices = np.ascontiguousarray(intrinsics, float)
    return _mspd(matrices @ _top_rows(estimated), matrices, _top_rows(true), _top_rows(symmetries), np.ascontiguousarray(points.spread))


def vsd(
    measured_mm: np.ndarray,
    estimated: DepthPatch,
    true: DepthPatch,
    intrinsics: np.ndarray,
    diameter_mm: float,
    delta_mm: float,
    taus: np.ndarray = VSD_TAUS,
) -> np.ndarray:
    """(T,) visible surface discrepancy, 0..1, at each tolerance in `taus`.

    Args:
        measured_mm: (height, width) depth of the scene; where it is 0, nothing was measured and the object counts as visible.
        estimated, true: the model's depth in the two poses.
        intrinsics: (3, 3) BOP's K.
        diameter_mm: of the model; distances are divided by it.
        delta_mm: how far behind the measured surface the model is still visible.
    """
    height, width = measured_mm.shape
    left, top = min(estimated.left, true.left), min(estimated.top, true.top)
    right = min(max(estimated.left + estimated.depth_mm.shape[1], true.left + true.depth_mm.shape[1]), width)
    bottom = min(max(estimated.top + estimated.depth_mm.shape[0], true.top + true.depth_mm.shape[0]), height)
    box = (left, top, right, bottom)
    x = (np.arange(left, right) - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (np.arange(top, bottom) - intrinsics[1, 2]) / intrinsics[1, 1]
    measured = np.ascontiguousarray(measured_mm[top:bottom, left:right])
    return _vsd(measured, estimated.within(box), true.within(box), x, y, float(diameter_mm), np.float32(delta_mm), taus)


def _top_rows(transforms: np.ndarray) -> np.ndarray:
    """(N, 3, 4) of (N, 4, 4)."""
    return np.ascontiguousarray(transforms[:, :3], float)


@numba.njit(cache=True, forceinline=True)
def _compose(true: np.ndarray, symmetry: np.ndarray, out: np.ndarray) -> None:
    """out = true @ symmetry of (3, 4) transforms."""
    for row in range(3):
        for column in range(4):
            total = true[row, 3] if column == 3 else 0.0
            for k in range(3):
                total += true[row, k] * symmetry[k, column]
            out[row, column] = total


@numba.njit(cache=True, parallel=True)
def _mssd(estimated: np.ndarray, true: np.ndarray, symmetries: np.ndarray, points: np.ndarray) -> np.ndarray:
    """`mssd` of (N, 3, 4) poses. A symmetry is given up at the first point where it is worse than the best one."""
    errors = np.empty(len(estimated))
    for pair in numba.prange(len(estimated)):
        turned = np.empty((3, 4))
        best = np.inf
        for symmetry in range(len(symmetries)):
            _compose(true[pair], symmetries[symmetry], turned)
            worst = 0.0
            for index in range(len(points)):
                squared = 0.0
                for row in range(3):
                    difference = estimated[pair, row, 3] - turned[row, 3]
                    for k in range(3):
                        difference += (estimated[pair, row, k] - turned[row, k]) * points[index, k]
                    squared += difference * difference
                if squared > worst:
                    worst = squared
                    if worst >= best:
                        break
            best = min(best, worst)
        errors[pair] = np.sqrt(best)
    return errors


@numba.njit(cache=True, forceinline=True)
def _project(matrix: np.ndarray, point: np.ndarray) -> tuple[float, float]:
    """Pixel of a point by a (3, 4) projection; infinite in the camera plane."""
    x = matrix[0, 0] * point[0] + matrix[0, 1] * point[1] + matrix[0, 2] * point[2] + matrix[0, 3]
    y = matrix[1, 0] * point[0] + matrix[1, 1] * point[1] + matrix[1, 2] * point[2] + matrix[1, 3]
    z = matrix[2, 0] * point[0] + matrix[2, 1] * point[1] + matrix[2, 2] * point[2] + matrix[2, 3]
    if z == 0.0:
        return np.inf, np.inf
    return x / z, y / z


@numba.njit(cache=True, parallel=True)
def _mspd(projections: np.ndarray, intrinsics: np.ndarray, true: np.ndarray, symmetries: np.ndarray, points: np.ndarray) -> np.ndarray:
    """`mspd` of (N, 3, 4) projections. A symmetry is given up at the first point where it is worse than the best one."""
    errors = np.empty(len(projections))
    for pair in numba.prange(len(projections)):
        turned, matrix = np.empty((3, 4)), np.empty((3, 4))
        seen = np.empty((len(points), 2))
        for index in range(len(points)):
            seen[index, 0], seen[index, 1] = _project(projections[pair], points[index])
        best = np.inf
        for symmetry in range(len(symmetries)):
            _compose(true[pair], symmetries[symmetry], turned)
            for row in range(3):
                for column in range(4):
                    matrix[row, column] = 0.0
                    for k in range(3):
                        matrix[row, column] += intrinsics[pair, row, k] * turned[k, column]
            worst = 0.0
            for index in range(len(points)):
                x, y = _project(matrix, points[index])
                squared = (seen[index, 0] - x) ** 2 + (seen[index, 1] - y) ** 2
                if not squared <= worst:
                    worst = squared
                    if not worst < best:
                        break
            if worst < best:
                best = worst
        errors[pair] = np.sqrt(best)
    return errors


@numba.njit(cache=True, forceinline=True)
def _distance(x: float, y: float, depth: float) -> float:
    """Distance from the camera's centre, mm."""
    return np.sqrt((x * depth) ** 2 + (y * depth) ** 2 + np.float64(depth) ** 2)


@numba.njit(cache=True)
def _vsd(
    measured: np.ndarray,
    estimated: np.ndarray,
    true: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    diameter: float,
    delta: np.float32,
    taus: np.ndarray,
) -> np.ndarray:
    """`vsd` in a box. Visibility is decided in single precision, as in the benchmark's own evaluation."""
    union, alone = 0, 0
    misaligned = np.zeros(len(taus), np.int64)
    for row in range(measured.shape[0]):
        for column in range(measured.shape[1]):
            if estimated[row, column] == 0 and true[row, column] == 0:
                continue
            scene = np.float32(_distance(x[column], y[row], measured[row, column]))
            there = _distance(x[column], y[row], true[row, column])
            here = _distance(x[column], y[row], estimated[row, column])
            true_visible = true[row, column] > 0 and (np.float32(there) - scene <= delta or scene == 0)
            visible = estimated[row, column] > 0 and (np.float32(here) - scene <= delta or scene == 0 or true_visible)
            if not (true_visible or visible):
                continue
            union += 1
            if not (true_visible and visible):
                alone += 1
                continue
            distance = abs(there - here) / diameter
            for index in range(len(taus)):
                misaligned[index] += distance >= taus[index]
    if union == 0:
        return np.ones(len(taus))
    return (misaligned + alone) / union
