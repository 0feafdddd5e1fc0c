"""What marching cubes needs: the density of an octree on one lattice, and signed distances to the surface that depth maps show."""

from dataclasses import dataclass

import numba
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.svraster.kernels.intersection import DENSITY_SCALE, LINEAR_FROM
from zeroshop_steps.surface.svraster.octree import CELLS, Octree


@dataclass(frozen=True)
class DensityGrid:
    """Values at the points of a box of the lattice of one level.

    Attributes:
        values: (X, Y, Z) float32 density before activation, the mean over the leaves that share a point.
        covered: (X, Y, Z) bool, the points that belong to a leaf.
        first: (3,) lattice position of the first point.
        step: distance of two points in normalized units.
    """

    values: np.ndarray
    covered: np.ndarray
    first: np.ndarray
    step: float

    @staticmethod
    def from_octree(octree: Octree, densities: np.ndarray, border: int) -> "DensityGrid":
        """On the lattice of the finest level that there is, `border` points wider than the leaves on every side.

        Leaves of different levels share points on their common faces, and interpolate different values there. The mean is
        taken: with one value at each point, a surface through the lattice has no cracks.
        """
        unit = int(octree.cells.min())
        origins, cells = octree.origins // unit, octree.cells // unit
        first = origins.min(axis=0) - border
        shape = (origins + cells[:, None]).max(axis=0) + border + 1 - first
        total, count = np.zeros(shape, np.float32), np.zeros(shape, np.int32)
        _add(origins - first, cells, octree.corners, densities, total, count)
        return DensityGrid(total / np.maximum(count, 1), count > 0, first, unit * 2.0 / CELLS)

    def points(self, index: np.ndarray) -> np.ndarray:
        """(P, 3) normalized coordinates of (P, 3) indices into `values`, which need not be whole numbers."""
        return (index + self.first) * self.step - 1.0


@numba.njit(cache=True)
def _add(origins, cells, corners, densities, total, count):
    for i in range(len(origins)):
        n = cells[i]
        for x in range(n + 1):
            for y in range(n + 1):
                for z in range(n + 1):
                    value = np.float32(0.0)
                    for c in range(8):
                        weight = (x if c & 1 else n - x) * (y if c >> 1 & 1 else n - y) * (z if c >> 2 & 1 else n - z)
                        value += densities[corners[i, c]] * np.float32(weight / n**3)
                    total[origins[i, 0] + x, origins[i, 1] + y, origins[i, 2] + z] += value
                    count[origins[i, 0] + x, origins[i, 1] + y, origins[i, 2] + z] += 1


def half_opacity_value(step: float) -> float:
    """The density before activation at which a segment of length `step` has an opacity of one half."""
    density = np.log(2.0) / (DENSITY_SCALE * step)
    return float(density if density > LINEAR_FROM else LINEAR_FROM * (1.0 + np.log(density / LINEAR_FROM)))


def fuse_signed_distances(
    points: np.ndarray, cameras: list[Camera], depths: list[np.ndarray], reach: float, zero_is_free: bool, min_views: int
) -> np.ndarray:
    """(P,) float32 distance of (P, 3) points to the surface that depth maps describe, along the rays, positive before it.

    The mean of the views' distances, each truncated to `reach` (Curless & Levoy 1996). A view has no distance for a point that
    lies further than that behind its surface. A point for which fewer than `min_views` have one is hidden, and gets -reach.

    Args:
        depths: (H, W) float32 depth of the surface in each view, 0 where there is none.
        zero_is_free: whether the view sees past the object where its depth is 0, and beside its image, rather than knowing nothing.
    """
    total, count = np.zeros(len(points), np.float32), np.zeros(len(points), np.int32)
    for camera, depth in zip(cameras, depths, strict=True):
        _add_distances(points, camera.row, depth, reach, zero_is_free, total, count)
    return np.where(count >= min_views, total / np.maximum(count, 1), np.float32(-reach))


@numba.njit(cache=True, parallel=True)
def _add_distances(points, camera, depth, reach, zero_is_free, total, count):
    height, width = depth.shape
    for i in numba.prange(len(points)):
        p = points[i]
        x = camera[0] * p[0] + camera[1] * p[1] + camera[2] * p[2] + camera[9]
        y = camera[3] * p[0] + camera[4] * p[1] + camera[5] * p[2] + camera[10]
        z = camera[6] * p[0] + camera[7] * p[1] + camera[8] * p[2] + camera[11]
        if z <= 0:
            continue
        u, v = int(np.floor(camera[12] * x / z + camera[14])), int(np.floor(camera[13] * y / z + camera[15]))
        surface = depth[v, u] if 0 <= u < width and 0 <= v < height else 0.0
        distance = surface - z if surface > 0 else (reach if zero_is_free else -2.0 * reach)
        if distance >= -reach:
            total[i] += min(distance, reach)
            count[i] += 1
