"""The leaves of a sparse octree: their Morton keys, the corners that they share, and their order along a ray.

The root is the cube [-1, 1]^3 of normalized coordinates. A leaf of level l has edge 2 / 2^l; its place is that of its
lowest corner on the lattice of the finest level, whose coordinates, interleaved bit by bit, make its Morton key.
"""

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from zeroshop_steps.runtime.errors import StepError

MAX_LEVEL = 10
"""Finest level: 1024 leaves along an edge of the root."""
CELLS = 1 << MAX_LEVEL
CORNER_OFFSETS = np.array([[corner & 1, corner >> 1 & 1, corner >> 2 & 1] for corner in range(8)])
"""Corner c of a cube lies at these offsets along x, y, z."""
OCTANTS = len(CORNER_OFFSETS)
_ALL_X = sum(1 << (3 * bit) for bit in range(MAX_LEVEL))


@dataclass(frozen=True)
class Octree:
    """Disjoint leaves, sorted by Morton key.

    Attributes:
        origins: (N, 3) int64 lowest corner on the finest level's lattice.
        levels: (N,) int64.
    """

    origins: np.ndarray
    levels: np.ndarray

    def __post_init__(self) -> None:
        keys, spans = self.keys, (self.cells**3)[:-1]
        if len(keys) and ((np.diff(keys) < spans).any() or (self.origins % self.cells[:, None]).any()):
            raise StepError(
                "the leaves of the octree overlap, are unsorted or lie off their level's lattice; delete the file and train again"
            )

    @staticmethod
    def from_leaves(origins: np.ndarray, levels: np.ndarray) -> "Octree":
        """From leaves in any order."""
        order = np.argsort(morton_keys(origins), kind="stable")
        return Octree(np.ascontiguousarray(origins[order]), np.ascontiguousarray(levels[order]))

    @staticmethod
    def uniform(occupied: np.ndarray) -> "Octree":
        """The occupied cells of a (2^l, 2^l, 2^l) bool grid over the root, as leaves of level l."""
        level = int(occupied.shape[0]).bit_length() - 1
        cells = np.argwhere(occupied)
        return Octree.from_leaves(cells * (CELLS >> level), np.full(len(cells), level))

    def __len__(self) -> int:
        return len(self.levels)

    @cached_property
    def keys(self) -> np.ndarray:
        """(N,) Morton keys."""
        return morton_keys(self.origins)

    @cached_property
    def cells(self) -> np.ndarray:
        """(N,) edge in cells of the finest level."""
        return CELLS >> self.levels

    @cached_property
    def sizes(self) -> np.ndarray:
        """(N,) float64 edge in normalized units."""
        return self.cells * (2.0 / CELLS)

    @cached_property
    def centres(self) -> np.ndarray:
        """(N, 3) float64 centres in normalized coordinates."""
        return (self.origins + 0.5 * self.cells[:, None]) * (2.0 / CELLS) - 1.0

    @cached_property
    def _corner_table(self) -> tuple[np.ndarray, np.ndarray]:
        points = self.origins[:, None, :] + self.cells[:, None, None] * CORNER_OFFSETS
        keys = (points[..., 0] * (CELLS + 1) + points[..., 1]) * (CELLS + 1) + points[..., 2]
        unique, index = np.unique(keys, return_inverse=True)
        return unique, index.reshape(-1, 8).astype(np.int32)

    @property
    def corners(self) -> np.ndarray:
        """(N, 8) int32: which of the shared corners are a leaf's."""
        return self._corner_table[1]

    @property
    def corner_count(self) -> int:
        """Number of distinct corners."""
        return len(self._corner_table[0])

    @cached_property
    def corner_points(self) -> np.ndarray:
        """(M, 3) int64 corners on the finest level's lattice."""
        rest, z = np.divmod(self._corner_table[0], CELLS + 1)
        return np.stack([*np.divmod(rest, CELLS + 1), z], 1)

    @cached_property
    def corner_uses(self) -> tuple[np.ndarray, np.ndarray]:
        """(M + 1,) starts and (8 N,) entries: the places in the flat `corners` where each corner stands, in rising order."""
        flat = self.corners.ravel()
        starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=self.corner_count))])
        return starts, np.argsort(flat, kind="stable").astype(np.int32)

    @cached_property
    def orders(self) -> np.ndarray:
        """(8, N) int32: the leaves front to back for rays of each octant.

        Bit j of the octant is set where the ray's direction is negative along axis j. Along a ray that falls along an axis the
        two halves of every cube swap, which is one flipped bit of the key on every level (Sun et al. 2025, sec. 3.1): disjoint
        leaves are then in the order in which any such ray can meet them.
        """
        masks = [sum((octant >> axis & 1) * (_ALL_X << axis) for axis in range(3)) for octant in range(OCTANTS)]
        return np.stack([np.argsort(self.keys ^ mask, kind="stable") for mask in masks]).astype(np.int32)

    def refine(self, keep: np.ndarray, split: np.ndarray) -> tuple["Octree", np.ndarray]:
        """Keep the leaves of one (N,) bool mask and replace those of another, a part of it, by their eight children.

        Returns:
            The new tree, and (N',) the old leaf that each new leaf is or lies in. Leaves of the finest level are never split.
        """
        split = split & keep & (self.levels < MAX_LEVEL)
        whole, parents = np.flatnonzero(keep & ~split), np.flatnonzero(split)
        half = self.cells[parents] >> 1
        children = (self.origins[parents][:, None] + half[:, None, None] * CORNER_OFFSETS).reshape(-1, 3)
        origins = np.concatenate([self.origins[whole], children])
        levels = np.concatenate([self.levels[whole], np.repeat(self.levels[parents] + 1, 8)])
        source = np.concatenate([whole, np.repeat(parents, 8)])
        order = np.argsort(morton_keys(origins), kind="stable")
        return Octree(origins[order], levels[order]), source[order]

    def interpolate(self, values: np.ndarray, finer: "Octree", source: np.ndarray) -> np.ndarray:
        """Values (M,) at this tree's corners, carried to the corners of a tree from `refine`.

        A corner that several old leaves reach gets the mean of what they say: on the face of a larger leaf these differ.
        """
        total = np.zeros(finer.corner_count)
        _carry(self.origins, self.cells, self.corners, values, finer.origins, finer.cells, finer.corners, source, total)
        uses = np.bincount(finer.corners.ravel(), minlength=finer.corner_count)
        return (total / uses).astype(values.dtype)


@numba.njit(cache=True)
def _carry(origins, cells, corners, values, new_origins, new_cells, new_corners, source, total):
    for i in range(len(new_origins)):
        old = source[i]
        scale = 1.0 / cells[old]
        for corner in range(8):
            x = (new_origins[i, 0] - origins[old, 0] + (corner & 1) * new_cells[i]) * scale
            y = (new_origins[i, 1] - origins[old, 1] + (corner >> 1 & 1) * new_cells[i]) * scale
            z = (new_origins[i, 2] - origins[old, 2] + (corner >> 2 & 1) * new_cells[i]) * scale
            for c in range(8):
                weight = (x if c & 1 else 1.0 - x) * (y if c >> 1 & 1 else 1.0 - y) * (z if c >> 2 & 1 else 1.0 - z)
                total[new_corners[i, corner]] += weight * values[corners[old, c]]


def morton_keys(points: np.ndarray) -> np.ndarray:
    """(N,) int64 keys of (N, 3) lattice points: bit 3 b + j is bit b of coordinate j."""
    return _interleave(np.ascontiguousarray(points, dtype=np.int64))


@numba.njit(cache=True)
def _interleave(points):
    keys = np.zeros(len(points), np.int64)
    for i in range(len(points)):
        for bit in range(MAX_LEVEL):
            for axis in range(3):
                keys[i] |= ((points[i, axis] >> bit) & 1) << (3 * bit + axis)
    return keys
