"""A step of the adjustment by outlines and tracks: a damped least-squares problem in which a ray counts only where it misses.

Which rays miss after the step is not known before, so the set of them is found in turns with the step (a semismooth Newton method; Qi and
Sun 1993). Without that, a step that mends the rays that miss now makes others miss. Where a ray touches the object moves along with the
cameras: its depth is an unknown of its own, and eliminated as the points of the tracks are.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

TURNS = 8  # of the step and of the set of rays that miss
RIM_DEVIATION_PX = float(np.sqrt(1 / 12))  # of a rim that runs along pixels, evenly spread within one; per 1000 px of the image
USUAL_DEPTH = 0.1  # by which a touched point moves along its ray, in radii of the object, beyond which the linear model means little


@dataclass(frozen=True)
class Noise:
    """Usual errors, px per 1000 px of the image, that errors are divided by: much larger ones hardly count."""

    rims: float = 1.0
    tracks: float = 1.0


@dataclass(frozen=True)
class SilhouetteRows:
    """Signed distances of touched rays in other views, px per 1000 px, linearized. K of them; S unknowns of the cameras.

    Attributes:
        value: (K,) negative where a ray misses.
        jacobian: (K, S) sparse derivative by the cameras and the focal length.
        by_depth: (K,) derivative by the depth of the ray's touched point, in radii of the object.
        ray: (K,) number of the ray.
    """

    value: np.ndarray
    jacobian: csr_matrix
    by_depth: np.ndarray
    ray: np.ndarray

    def divided(self, unit_px: float) -> "SilhouetteRows":
        """The same in another unit than a pixel."""
        return SilhouetteRows(self.value / unit_px, self.jacobian / unit_px, self.by_depth / unit_px, self.ray)


@dataclass(frozen=True)
class TrackBlocks:
    """Gauss and Newton's approximation of the tracks' reprojection errors. P points; S unknowns of the cameras.

    Attributes:
        hessian, gradient: (S, S) and (S,) of the cameras and the focal length.
        coupling: (P, S, 3) with the points.
        points_hessian, points_gradient: (P, 3, 3) and (P, 3) of the points.
    """

    hessian: np.ndarray
    gradient: np.ndarray
    coupling: np.ndarray
    points_hessian: np.ndarray
    points_gradient: np.ndarray


def solve_step(outlines: SilhouetteRows, tracks: TrackBlocks, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """(S,) step of the cameras and the focal length, and (P, 3) step of the points."""
    inverse = np.linalg.inv(tracks.points_hessian * (1 + damping * np.eye(3)) + 1e-9 * np.eye(3))
    eliminated = np.einsum("pni,pij->pnj", tracks.coupling, inverse)
    hessian = tracks.hessian - np.einsum("pni,pmi->nm", eliminated, tracks.coupling, optimize=True)
    gradient = tracks.gradient - np.einsum("pni,pi->n", eliminated, tracks.points_gradient)
    missing = outlines.value < 0
    scale = np.diag(tracks.hessian) + _hold_depths(outlines, missing)[1].multiply(outlines.jacobian).sum(0).A1
    damped = hessian + np.diag(damping * scale + 1e-6 * scale.mean() + 1e-12)
    step = np.zeros(len(gradient))
    for _ in range(TURNS):
        blocks = _eliminate_depths(outlines, missing, damping)
        step = -np.linalg.solve(damped + blocks.hessian, gradient + blocks.gradient)
        after = outlines.value + outlines.jacobian @ step + outlines.by_depth * blocks.solve(step)[outlines.ray]
        before, missing = missing, after < 0
        if (before == missing).all():
            break
    points_step = -np.einsum("pij,pj->pi", inverse, tracks.points_gradient + np.einsum("pni,n->pi", tracks.coupling, step, optimize=True))
    return step, points_step


def find_information(outlines: SilhouetteRows) -> np.ndarray:
    """(S, S) what touched rays tell of the cameras and the focal length: the inverse of their covariance, for exact masks.

    A ray that lies inside a mask by less than its rim is unsure is held by it, too.
    """
    return _eliminate_depths(outlines, outlines.value < RIM_DEVIATION_PX, 0.0).hessian / RIM_DEVIATION_PX**2


@dataclass(frozen=True)
class _DepthBlocks:
    """The rays that miss, with the depths of their touched points eliminated: what that leaves for the cameras."""

    hessian: np.ndarray
    gradient: np.ndarray
    coupling: np.ndarray
    own: np.ndarray
    pull: np.ndarray

    def solve(self, step: np.ndarray) -> np.ndarray:
        """(R,) step of the depths by (S,) that of the cameras."""
        return -(self.pull + self.coupling @ step) / self.own


def _hold_depths(outlines: SilhouetteRows, missing: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
    """(K,) weights under the robust loss of the rays that miss, 0 of the others, and their weighed rows."""
    weight = missing / (1 + np.maximum(-outlines.value, 0.0))
    return weight, outlines.jacobian.multiply(weight[:, None]).tocsr()


def _eliminate_depths(outlines: SilhouetteRows, missing: np.ndarray, damping: float) -> _DepthBlocks:
    weight, weighed = _hold_depths(outlines, missing)
    count, rays = len(outlines.ray), int(outlines.ray.max(initial=-1)) + 1
    by_ray = csr_matrix((outlines.by_depth, (outlines.ray, np.arange(count))), (rays, count))
    coupling = (by_ray @ weighed).toarray()
    own = np.bincount(outlines.ray, weight * outlines.by_depth**2, rays) * (1 + damping) + 1 / USUAL_DEPTH**2
    pull = by_ray @ (weight * outlines.value)
    hessian = (weighed.T @ outlines.jacobian).toarray() - coupling.T @ (coupling / own[:, None])
    return _DepthBlocks(hessian, weighed.T @ outlines.value - coupling.T @ (pull / own), coupling, own, pull)
