"""Carve the visual hull by confirmed depths: what lies before them is empty, what lies just behind them is solid.

So the hollows of the hull open. Where stereo says nothing, the smallest surface spans the gap: the occupancy minimizes the
sum of its votes and of its total variation (Zach et al. 2007; Kolev et al. 2009). This convex problem is solved by
first-order primal-dual steps (Chambolle and Pock 2011).
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import distance_transform_edt

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visual_hull import VisualHull, voxel_centres

# Each view's depth votes for each voxel of the hull. The weights below were set by hand on hollow objects (mug and bowl), with
# hulls of 128 voxels along an edge.
SOLID_VOXELS = 2.0
"""A confirmed surface declares what lies up to this far behind it solid."""
FREE_MARGIN_VOXELS = 1.0
"""It declares empty what lies further before it than this, so that a voxel cut by the surface stays."""
SOLID_WEIGHT = 2.0
"""A vote for solid counts as much as this many votes for empty, so that walls are not opened easily."""
FREE_VIEWS_MIN = 2.0
"""Up to this many votes for empty count nothing: one or two views may be wrong."""
FULL_VOTE_VIEWS = 3.0
"""A majority of so many views counts as a full vote."""
FILL_VOTE = 0.1
"""Vote for solid, as a share of a full one, where no view says solid and too few say empty: what nobody has seen stays."""
SMOOTHNESS = 0.3
"""Cost of one voxel's face of surface, as a share of a full vote."""
STEPS = 200
"""Of the primal-dual iteration."""
MEDIAN_BLOCK_PX = 4
"""Confirmed depths are reduced to their medians in blocks of this many pixels, which are about a voxel wide."""


@dataclass(frozen=True)
class HullDistanceField:
    """How far the voxels of the cube [-half_extent, half_extent]^3 lie outside a hull.

    Attributes:
        distance_voxels: (R, R, R) distance from each voxel to the nearest one of the hull, 0 inside.
    """

    distance_voxels: np.ndarray
    half_extent: float

    @staticmethod
    def from_hull(hull: VisualHull) -> "HullDistanceField":
        """The distances from a hull; all infinite where it is empty."""
        distance = distance_transform_edt(~hull.occupied) if hull.occupied.any() else np.full(hull.occupied.shape, np.inf)
        return HullDistanceField(distance.astype(np.float32), hull.half_extent)

    def farther_than(self, points: np.ndarray, voxels: float | np.ndarray) -> np.ndarray:
        """(P,) bool: which (P, 3) points lie more than `voxels`, or each its own of (P,), outside."""
        resolution = len(self.distance_voxels)
        index = np.floor((points / self.half_extent + 1) * resolution / 2).astype(int)
        outside = ((index < 0) | (index >= resolution)).any(axis=1)
        i, j, k = index.clip(0, resolution - 1).T
        return outside | (self.distance_voxels[i, j, k] > voxels)


def carve_free_space(hull: VisualHull, cameras: list[Camera], depth_maps: list[np.ndarray]) -> VisualHull:
    """Remove from a hull what confirmed depths have shown to be empty.

    Args:
        depth_maps: for each camera, (H, W) confirmed depth along the optical axis, 0 where nothing is known.
    """
    resolution, voxel = len(hull.occupied), 2 * hull.half_extent / len(hull.occupied)
    centres = voxel_centres(hull.half_extent, resolution)[hull.occupied.ravel()]
    free, solid = np.zeros(len(centres), np.float32), np.zeros(len(centres), np.float32)
    for camera, depth in zip(cameras, depth_maps, strict=True):
        blocks = _median_in_blocks(depth, MEDIAN_BLOCK_PX)
        pixels, z = camera.project(centres)
        x, y = np.floor(pixels / MEDIAN_BLOCK_PX).astype(int).T
        framed = (x >= 0) & (y >= 0) & (x < blocks.shape[1]) & (y < blocks.shape[0])
        found = np.where(framed, blocks[y.clip(0, blocks.shape[0] - 1), x.clip(0, blocks.shape[1] - 1)], 0.0)
        behind = (z - found) / voxel
        free += (found > 0) & (behind < -FREE_MARGIN_VOXELS)
        solid += (found > 0) & (behind > -0.5) & (behind < SOLID_VOXELS)
    votes = np.clip((free - FREE_VIEWS_MIN - SOLID_WEIGHT * solid) / FULL_VOTE_VIEWS, -1.0, 1.0)
    votes[(free <= FREE_VIEWS_MIN) & (solid == 0)] = -FILL_VOTE
    grid = np.ones(hull.occupied.shape, np.float32)
    grid[hull.occupied] = votes
    occupancy = minimize_surface(grid, hull.occupied, SMOOTHNESS, STEPS)
    return VisualHull(occupancy > 0.5, hull.half_extent)


def _median_in_blocks(depth: np.ndarray, side: int) -> np.ndarray:
    """Medians of the known depths in blocks of side x side pixels, 0 where none is known."""
    height, width = -(-depth.shape[0] // side), -(-depth.shape[1] // side)
    padded = np.zeros((height * side, width * side), np.float32)
    padded[: depth.shape[0], : depth.shape[1]] = depth
    blocks = padded.reshape(height, side, width, side).swapaxes(1, 2).reshape(height, width, -1)
    known = np.sort(np.where(blocks > 0, blocks, np.inf), axis=2)
    count = (blocks > 0).sum(axis=2)
    middle = np.take_along_axis(known, np.maximum(count - 1, 0)[..., None] // 2, axis=2)[..., 0]
    return np.where(count > 0, middle, 0.0)


def minimize_surface(votes: np.ndarray, inside: np.ndarray, smoothness: float, steps: int) -> np.ndarray:
    """(R, R, R) float32 occupancy in [0, 1] that minimizes sum(u * votes) + smoothness * total variation, 0 outside the hull."""
    occupancy = np.where(votes < 0, np.float32(1), np.float32(0))
    _descend(occupancy, occupancy.copy(), np.zeros((3, *votes.shape), np.float32), votes, inside, smoothness, steps)
    return occupancy


@numba.njit(cache=True, parallel=True)
def _descend(u, previous, p, votes, inside, smoothness, steps):
    """The primal-dual iteration on occupancy u, what it was before, and the dual variables p (3, R, R, R), all in place."""
    n0, n1, n2 = votes.shape
    tau = sigma = np.float32(1 / np.sqrt(12.0))
    for _ in range(steps):
        for i in numba.prange(n0 - 1):
            for j in range(n1 - 1):
                for k in range(n2 - 1):
                    here = 2 * u[i, j, k] - previous[i, j, k]
                    a = p[0, i, j, k] + sigma * (2 * u[i + 1, j, k] - previous[i + 1, j, k] - here)
                    b = p[1, i, j, k] + sigma * (2 * u[i, j + 1, k] - previous[i, j + 1, k] - here)
                    c = p[2, i, j, k] + sigma * (2 * u[i, j, k + 1] - previous[i, j, k + 1] - here)
                    scale = max(np.float32(1), np.sqrt(a * a + b * b + c * c) / smoothness)
                    p[0, i, j, k], p[1, i, j, k], p[2, i, j, k] = a / scale, b / scale, c / scale
        for i in numba.prange(1, n0):
            for j in range(1, n1):
                for k in range(1, n2):
                    old = u[i, j, k]
                    previous[i, j, k] = old
                    if inside[i, j, k]:
                        divergence = (
                            p[0, i, j, k] - p[0, i - 1, j, k] + p[1, i, j, k] - p[1, i, j - 1, k] + p[2, i, j, k] - p[2, i, j, k - 1]
                        )
                        u[i, j, k] = min(max(old + tau * (divergence - votes[i, j, k]), np.float32(0)), np.float32(1))
