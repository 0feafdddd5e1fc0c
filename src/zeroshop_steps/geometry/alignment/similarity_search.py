"""The coarse alignment of two surfaces: iterated closest points with scale from many rotations at once."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.alignment.surface_points import SurfacePoints
from zeroshop_steps.geometry.cameras.transforms import compute_scale
from zeroshop_steps.geometry.cameras.viewpoints import spread_over_sphere

DIRECTIONS, TURNS = 60, 12  # of the starts: 720 rotations, about 30 degrees apart
FIRST_STEPS, LAST_STEPS = 10, 16  # of ICP, with all starts and with the best
KEPT_SHARE = 0.25  # of the starts, the best, for the second round
FIRST_SAMPLES, SAMPLES, TARGET_SAMPLES = 100, 250, 6000  # of the source in both rounds, and of the target, which is searched
NEAR_SHARE = 0.85  # of points, the nearest, that must fit; the others may be floaters, a lid, or another object
FAR_SHARE = 0.7  # of the target's samples, the nearest, that must fit; no photo may have seen the others
LEAST_SCALE_CHANGE = 0.75  # the scale stays between 3/4 and 4/3 of the first guess; otherwise a surface could shrink into the other
LOW_PERCENT, SIZE_PERCENT = 1, 95  # percentiles of the positions that give centre and size of the first guess, against outliers
DAMPING, TINY_DAMPING = 1e-4, 1e-9  # of the least squares, relative and absolute: what the surfaces do not fix stays as it is
LARGEST_TURN, LARGEST_GROWTH = 0.5, 0.1  # radians about each axis, and logarithm of the scale, in one step; beyond, it is not linear


@dataclass(frozen=True)
class SimilarityCandidates:
    """Alignments found, the best first.

    Attributes:
        transforms: (C, 4, 4) similarities target_from_source.
        residuals: (C,) mean distance of the nearest samples, in both directions, in the target's unit.
    """

    transforms: np.ndarray
    residuals: np.ndarray


def search_similarities(source: SurfacePoints, target: SurfacePoints) -> SimilarityCandidates:
    """Align samples of a surface that may lack parts with those of the whole surface, starting from all rotations."""
    search_in = _PairedSurfaces(source, target)
    transforms = _start_transforms(source, target)
    scale = compute_scale(transforms[0])
    for _ in range(FIRST_STEPS):
        transforms = search_in.step(transforms, FIRST_SAMPLES, scale)
    order = np.argsort(search_in.residuals(transforms, FIRST_SAMPLES), kind="stable")
    transforms = transforms[order[: int(KEPT_SHARE * len(order))]]
    for _ in range(LAST_STEPS):
        transforms = search_in.step(transforms, SAMPLES, scale)
    residuals = search_in.residuals(transforms, SAMPLES)
    order = np.argsort(residuals, kind="stable")
    return SimilarityCandidates(transforms[order], residuals[order])


class _PairedSurfaces:
    """Two surfaces with search trees for their nearest samples."""

    def __init__(self, source: SurfacePoints, target: SurfacePoints) -> None:
        self._source, self._target = source.part(TARGET_SAMPLES), target.part(TARGET_SAMPLES)
        self._source_tree, self._target_tree = cKDTree(self._source.points), cKDTree(self._target.points)
        self._middle = self._target.points.mean(0)

    def step(self, transforms: np.ndarray, samples: int, scale: float) -> np.ndarray:
        """One step of point-to-plane ICP with scale for all transforms (Chen and Medioni 1991; scale: Zinsser et al. 2005)."""
        moved = _transform_points(transforms, self._source.points[:samples])
        distance, nearest = (found.reshape(moved.shape[:2]) for found in self._target_tree.query(moved.reshape(-1, 3)))
        turned = self._source.normals[:samples] @ transforms[:, :3, :3].transpose(0, 2, 1)
        normals = self._target.normals[nearest]
        weights = (distance <= np.quantile(distance, NEAR_SHARE, axis=1, keepdims=True)) & (np.einsum("cni,cni->cn", turned, normals) > 0)
        offsets, gaps = moved - self._middle, np.einsum("cni,cni->cn", self._target.points[nearest] - moved, normals)
        rows = np.concatenate([np.cross(offsets, normals), normals, np.einsum("cni,cni->cn", offsets, normals)[..., None]], 2)
        updated = apply_steps(transforms, solve_steps(rows, gaps, weights.astype(float)), self._middle)
        sizes = np.cbrt(np.linalg.det(updated[:, :3, :3]))
        within = np.clip(sizes, LEAST_SCALE_CHANGE * scale, scale / LEAST_SCALE_CHANGE) / sizes
        updated[:, :3, 3] = self._middle + within[:, None] * (updated[:, :3, 3] - self._middle)
        updated[:, :3, :3] *= within[:, None, None]
        return updated

    def residuals(self, transforms: np.ndarray, samples: int) -> np.ndarray:
        """(C,) mean distance of the nearest samples, in both directions, in the target's unit."""
        moved = _transform_points(transforms, self._source.points[:samples])
        near = np.sort(self._target_tree.query(moved.reshape(-1, 3))[0].reshape(moved.shape[:2]), axis=1)
        back = _transform_points(np.linalg.inv(transforms), self._target.points[:samples])
        sizes = np.cbrt(np.linalg.det(transforms[:, :3, :3]))
        far = np.sort(self._source_tree.query(back.reshape(-1, 3))[0].reshape(back.shape[:2]), axis=1) * sizes[:, None]
        return (near[:, : int(NEAR_SHARE * samples)].mean(1) + far[:, : int(FAR_SHARE * samples)].mean(1)) / 2


def _start_transforms(source: SurfacePoints, target: SurfacePoints) -> np.ndarray:
    """(DIRECTIONS * TURNS, 4, 4) similarities that align centre and size, with evenly spread rotations."""
    polar, azimuth = spread_over_sphere(DIRECTIONS)
    tilts = Rotation.from_euler("zy", np.stack([azimuth, polar], 1))
    turns = Rotation.from_euler("z", np.arange(TURNS)[:, None] * 2 * np.pi / TURNS)
    rotations = np.concatenate([(tilt * turns).as_matrix() for tilt in tilts])
    bounds = LOW_PERCENT, 100 - LOW_PERCENT
    source_middle, target_middle = (np.percentile(part.points, bounds, axis=0).mean(0) for part in (source, target))
    source_size, target_size = (
        np.percentile(np.linalg.norm(part.points - middle, axis=1), SIZE_PERCENT)
        for part, middle in ((source, source_middle), (target, target_middle))
    )
    transforms = np.tile(np.eye(4), (len(rotations), 1, 1))
    transforms[:, :3, :3] = rotations * target_size / source_size
    transforms[:, :3, 3] = target_middle - transforms[:, :3, :3] @ source_middle
    return transforms


def solve_steps(rows: np.ndarray, gaps: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(C, 7) least-squares changes (rotation, translation, growth) from (C, N, 7) rows, slightly damped."""
    normal = np.einsum("cni,cnj,cn->cij", rows, rows, weights, optimize=True)
    right = np.einsum("cni,cn,cn->ci", rows, gaps, weights, optimize=True)
    damping = DAMPING * np.einsum("cii->ci", normal)[..., None] * np.eye(7) + TINY_DAMPING * np.eye(7)
    return np.linalg.solve(normal + damping, right[..., None])[..., 0]


def apply_steps(transforms: np.ndarray, changes: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Apply (C, 7) small changes about a point to (C, 4, 4) similarities."""
    turn = Rotation.from_rotvec(np.clip(changes[:, :3], -LARGEST_TURN, LARGEST_TURN)).as_matrix()
    grown = turn * np.exp(np.clip(changes[:, 6], -LARGEST_GROWTH, LARGEST_GROWTH))[:, None, None]
    updated = transforms.copy()
    updated[:, :3, :3] = grown @ transforms[:, :3, :3]
    updated[:, :3, 3] = np.einsum("cij,cj->ci", grown, transforms[:, :3, 3] - middle) + middle + changes[:, 3:6]
    return updated


def _transform_points(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(C, N, 3): (N, 3) points under each of (C, 4, 4) similarities."""
    return points @ transforms[:, :3, :3].transpose(0, 2, 1) + transforms[:, None, :3, 3]
