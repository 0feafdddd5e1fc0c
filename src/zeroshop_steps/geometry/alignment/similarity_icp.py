"""The exact alignment of two surfaces: point-to-plane ICP with scale, and print where shape decides nothing."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.alignment.similarity_search import NEAR_SHARE, SimilarityCandidates, apply_steps, solve_steps
from zeroshop_steps.geometry.alignment.surface_points import PLANE_NEIGHBOURS, SurfacePoints
from zeroshop_steps.geometry.cameras.transforms import transform_points

SAMPLES = 4000  # of the source, that are aligned
STEPS = 40  # of ICP
FAR_MEDIANS = 3.0  # samples farther away than so many median distances are not on the object, such as those of a lid
ALIKE_DIAMETERS = 0.003  # candidates whose residuals differ by less fit the shape equally well, and print decides
TRIED = 6  # candidates that are refined
PRINT_DIAMETERS = 0.01  # cost of print without any correlation, in distance of the shapes; a mean distance of 1 % outweighs it
PRINT_WEIGHT, PRINT_SCALE = 0.1, 0.1  # of brightness in a step: one standard deviation counts like a distance of 1 % of the size
CLIPPED_DEVIATIONS = 1.5  # larger differences of brightness count like this one; they are highlights or holes in the print
NORMAL_DAMPING = 1e-3  # of the brightness gradients, against directions in which the neighbours do not spread


@dataclass(frozen=True)
class SimilarityFit:
    """One alignment.

    Attributes:
        transform: (4, 4) similarity target_from_source.
        distance: mean distance of the nearest `NEAR_SHARE` of the source's samples to the target's surface.
        likeness: -1..1, correlation of the colours of the two surfaces; 0 if one has none.
    """

    transform: np.ndarray
    distance: float
    likeness: float


class SimilarityRefiner:
    """Refines alignments of one pair of surfaces."""

    def __init__(self, source: SurfacePoints, target: SurfacePoints) -> None:
        self._source, self._target = source.part(SAMPLES), target
        self._tree = cKDTree(target.points)
        self._middle = target.points.mean(0)
        self._size = float(np.linalg.norm(np.ptp(target.points, axis=0)))
        self._spacing = float(np.median(self._tree.query(target.points[:SAMPLES], k=2)[0][:, 1]))
        self._printed = source.colors is not None and target.colors is not None
        if self._printed:
            self._slopes = _brightness_gradients(target, self._tree)

    def choose_best(self, candidates: SimilarityCandidates) -> list[SimilarityFit]:
        """Refine the candidates that fit the shape about as well as the best; returns them by shape and print, the best first."""
        limit = candidates.residuals[0] + ALIKE_DIAMETERS * self._size
        alike = candidates.transforms[candidates.residuals <= limit]
        costs = np.array([self._cost(self.measure(transform)) for transform in alike])
        tried = alike[np.argsort(costs, kind="stable")[:TRIED]]
        return sorted((self.refine(transform) for transform in tried), key=self._cost)

    def _cost(self, fit: SimilarityFit) -> float:
        """The cost of an alignment by shape and print, in sizes of the target."""
        return fit.distance / self._size + PRINT_DIAMETERS * (1.0 - fit.likeness)

    def refine(self, transform: np.ndarray) -> SimilarityFit:
        """The alignment after `STEPS` steps."""
        for _ in range(STEPS):
            transform = self._step(transform)
        return self.measure(transform)

    def measure(self, transform: np.ndarray) -> SimilarityFit:
        """Measure how well an alignment fits."""
        moved, nearest, gaps, weights = self._match(transform)
        within = self._target.points[nearest] - moved
        planes = np.abs(np.einsum("ni,ni->n", within, self._target.normals[nearest]))
        distance = float(np.sort(planes)[: int(NEAR_SHARE * len(planes))].mean())
        ours, theirs = self._source.colors, self._target.colors
        if ours is None or theirs is None:
            return SimilarityFit(transform, distance, 0.0)
        return SimilarityFit(transform, distance, correlate_colors(ours[weights > 0], theirs[nearest][weights > 0]))

    def _match(self, transform: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The moved samples, index and gap along the normal of the nearest sample of the target, and weights, 0 or 1."""
        moved = transform_points(self._source.points, transform)
        distance, nearest = self._tree.query(moved)
        normals = self._target.normals[nearest]
        turned = self._source.normals @ transform[:3, :3].T
        near = distance <= min(np.quantile(distance, NEAR_SHARE), max(FAR_MEDIANS * np.median(distance), self._spacing))
        weights = near & (np.einsum("ni,ni->n", turned, normals) > 0)
        gaps = np.einsum("ni,ni->n", self._target.points[nearest] - moved, normals)
        return moved, nearest, gaps, weights.astype(float)

    def _step(self, transform: np.ndarray) -> np.ndarray:
        """One Gauss-Newton step on shape and print together (Park et al., Colored Point Cloud Registration, 2017), with scale."""
        moved, nearest, gaps, weights = self._match(transform)
        offsets, normals = moved - self._middle, self._target.normals[nearest]
        rows = similarity_rows(offsets, normals)
        if self._source.colors is not None and self._target.colors is not None:
            ours, theirs = _brightness(self._source.colors), _brightness(self._target.colors)[nearest]
            used = weights > 0
            spread = max(theirs[used].std(), 1e-6)
            ours = (ours - ours[used].mean()) / max(ours[used].std(), 1e-6) * spread + theirs[used].mean()
            slopes = self._slopes[nearest]
            across = moved - self._target.points[nearest]
            here = theirs + np.einsum("ni,ni->n", slopes, across)
            strength = PRINT_WEIGHT * self._size / spread * PRINT_SCALE
            rows = np.concatenate([rows, strength * similarity_rows(offsets, slopes)])
            error = np.clip(ours - here, -CLIPPED_DEVIATIONS * spread, CLIPPED_DEVIATIONS * spread)
            gaps, weights = np.concatenate([gaps, strength * error]), np.concatenate([weights, weights])
        change = solve_steps(rows[None], gaps[None], weights[None])
        return apply_steps(transform[None], change, self._middle)[0]


def similarity_rows(offsets: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N, 7) derivatives of the positions along `directions` by rotation, translation and growth."""
    return np.concatenate([np.cross(offsets, directions), directions, np.einsum("ni,ni->n", offsets, directions)[:, None]], 1)


def _brightness(colors: np.ndarray) -> np.ndarray:
    """(N,) brightness of (N, 3) colours."""
    return np.asarray(cv2.cvtColor(colors[None].astype(np.float32), cv2.COLOR_RGB2GRAY)[0], float)


def correlate_colors(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Correlation, -1..1, of two (N, 3) lists of colours in brightness, red-green and yellow-blue; what varies more weighs more."""
    axes = np.array([[0.7, -0.7, 0.0], [0.5, 0.5, -1.0]]).T
    a, b = (np.column_stack([_brightness(colors), colors @ axes]) for colors in (ours, theirs))
    a, b = a - a.mean(0), b - b.mean(0)
    return float((a * b).sum() / np.sqrt(max((a**2).sum() * (b**2).sum(), 1e-12)))


def _brightness_gradients(target: SurfacePoints, tree: cKDTree) -> np.ndarray:
    """(N, 3) gradient of brightness along the surface at each sample, by least squares over its neighbours."""
    _, near = tree.query(target.points, PLANE_NEIGHBOURS)
    assert target.colors is not None
    brightness = _brightness(target.colors)
    offsets = target.points[near] - target.points[:, None]
    offsets -= np.einsum("nki,ni->nk", offsets, target.normals)[..., None] * target.normals[:, None]
    rises = brightness[near] - brightness[:, None]
    normal = np.einsum("nki,nkj->nij", offsets, offsets)
    scale = np.einsum("nii->n", normal)[:, None, None]
    # The neighbours say nothing about the direction of the normal, so the gradient there is held at zero.
    normal += scale * (target.normals[:, :, None] * target.normals[:, None, :] + NORMAL_DAMPING * np.eye(3)) + 1e-12 * np.eye(3)
    return np.linalg.solve(normal, np.einsum("nki,nk->ni", offsets, rises)[..., None])[..., 0]
