"""Signed distances to the surface that depth maps show, on the lattice of an octree."""

from dataclasses import dataclass

import numba
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.svraster.octree import CELLS, Octree


@dataclass(frozen=True)
class Lattice:
    """The points of a box at the corners of an octree's finest leaves.

    Attributes:
        first: (3,) place of the first point on the lattice of the whole root.
        shape: number of points along each axis.
        step: distance of two points in normalized units.
    """

    first: np.ndarray
    shape: tuple[int, ...]
    step: float

    @staticmethod
    def around(octree: Octree, border: int) -> "Lattice":
        """Of the finest level that there is, `border` points wider than the leaves on every side."""
        unit = int(octree.cells.min())
        first = octree.origins.min(axis=0) // unit - border
        last = (octree.origins + octree.cells[:, None]).max(axis=0) // unit + border
        return Lattice(first, tuple((last + 1 - first).tolist()), unit * 2.0 / CELLS)

    def points(self, index: np.ndarray) -> np.ndarray:
        """(P, 3) normalized coordinates of (P, 3) indices, which need not be whole numbers."""
        return (index + self.first) * self.step - 1.0

    def layer(self, number: int) -> np.ndarray:
        """(Y * Z, 3) normalized coordinates of all points whose first index is this number."""
        return self.points(np.indices((1, *self.shape[1:])).reshape(3, -1).T + [number, 0, 0])


def fuse_signed_distances(
    points: np.ndarray, cameras: list[Camera], depths: list[np.ndarray], reach: float, zero_is_free: bool, min_views: int
) -> np.ndarray:
    """(P,) float32 distance of (P, 3) points to the surface that depth maps describe, along the rays, positive before it.

    The mean of the views' distances, each truncated to `reach` (Curless & Levoy 1996). A view has no distance for a point that
    lies further than that behind its surface. A point for which fewer than `min_views` have one is hidden, and gets -reach.

    Args:
        depths: (H, W) float32 depth of the surface in each view, 0 where there is none, negative where it is unknown.
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
        if surface < 0:
            continue
        distance = surface - z if surface > 0 else (reach if zero_is_free else -2.0 * reach)
        if distance >= -reach:
            total[i] += min(distance, reach)
            count[i] += 1
