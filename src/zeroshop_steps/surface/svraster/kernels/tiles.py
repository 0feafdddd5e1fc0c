"""Which voxels each tile of the image shows, front to back.

The order of voxels along a ray depends on the signs of its direction alone. A tile whose rays have several sign
patterns is drawn once for each: an pair is a pair of a tile and an octant of directions.
"""

from dataclasses import dataclass

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import TILE_PX
from zeroshop_steps.surface.svraster.octree import OCTANTS


@dataclass(frozen=True)
class TileOctants:
    """The (tile, octant) pairs of a view that are drawn.

    Attributes:
        tiles, octants: (I,) tile index and octant.
        index: (tiles_y, tiles_x, 8) int32 number of each pair, -1 for pairs that are not drawn.
        of_pixel: (16 * tiles_y, 16 * tiles_x) uint8 octant of each pixel in the tiles that are drawn.
    """

    tiles: np.ndarray
    octants: np.ndarray
    index: np.ndarray
    of_pixel: np.ndarray

    @staticmethod
    def from_camera(camera: np.ndarray, tile_active: np.ndarray) -> "TileOctants":
        """For a camera row (16,) and the (tiles_y, tiles_x) bool tiles to draw."""
        present = np.zeros((*tile_active.shape, OCTANTS), np.bool_)
        of_pixel = np.zeros((tile_active.shape[0] * TILE_PX, tile_active.shape[1] * TILE_PX), np.uint8)
        _octants(camera, tile_active, present, of_pixel)
        index = np.full(present.shape, -1, np.int32)
        index[present] = np.arange(present.sum())
        y, x, octants = np.nonzero(present)
        # A column of what nonzero found; kernels are compiled for arrays without gaps.
        return TileOctants(y * tile_active.shape[1] + x, np.ascontiguousarray(octants), index, of_pixel)


@numba.njit(cache=True, forceinline=True)
def ray_direction(camera, x, y, axis):
    """World direction, along one axis, of the ray through pixel position (x, y), of unit depth; never zero."""
    d = camera[axis] * (x - camera[14]) / camera[12] + camera[3 + axis] * (y - camera[15]) / camera[13] + camera[6 + axis]
    return d if abs(d) > 1e-7 else (-1e-7 if d < 0 else 1e-7)


@numba.njit(cache=True, forceinline=True)
def octant_of(camera, x, y):
    """Bit j is set where the ray's direction is negative along axis j."""
    octant = 0
    for axis in range(3):
        octant |= (ray_direction(camera, x, y, axis) < 0) << axis
    return octant


@numba.njit(cache=True)
def _octants(camera, tile_active, present, of_pixel):
    for ty in range(tile_active.shape[0]):
        for tx in range(tile_active.shape[1]):
            if tile_active[ty, tx]:
                for y in range(ty * TILE_PX, (ty + 1) * TILE_PX):
                    for x in range(tx * TILE_PX, (tx + 1) * TILE_PX):
                        octant = octant_of(camera, x + 0.5, y + 0.5)
                        present[ty, tx, octant], of_pixel[y, x] = True, octant


@dataclass(frozen=True)
class TileOctantLists:
    """The voxels of each pair, front to back.

    Attributes:
        pairs: (I',) the pairs that are not empty, longest list first, so that threads finish together.
        starts: (I + 1,) where each pair's list begins in `voxel_of` and `slot_of`.
        voxel_of: (E,) the voxel of each list entry.
        slot_of: (E,) row where that entry's gradient is stored; the rows of one voxel lie together.
        slot_starts: (N + 1,) first row of each voxel.
    """

    pairs: np.ndarray
    starts: np.ndarray
    voxel_of: np.ndarray
    slot_of: np.ndarray
    slot_starts: np.ndarray


def list_voxels_by_tile(tile_octants: TileOctants, orders: np.ndarray, boxes: np.ndarray) -> TileOctantLists:
    """Sort voxels into the (tile, octant) pairs that they meet.

    Args:
        orders: (8, N) int32 front-to-back orders of `Octree.orders`.
        boxes: (N, 4) int32 pixel boxes x0, x1, y0, y1.
    """
    per_pair, per_voxel = np.zeros(len(tile_octants.tiles), np.int64), np.zeros(len(boxes), np.int64)
    _count(boxes, tile_octants.index, per_pair, per_voxel)
    starts = np.concatenate([[0], np.cumsum(per_pair)])
    slot_starts = np.concatenate([[0], np.cumsum(per_voxel)])
    voxel_of, slot_of = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.int32)
    used = np.zeros(OCTANTS, np.bool_)
    used[tile_octants.octants] = True
    _fill(orders, used, boxes, tile_octants.index, starts[:-1].copy(), slot_starts, voxel_of, slot_of)
    longest = np.argsort(-per_pair, kind="stable")
    return TileOctantLists(longest[per_pair[longest] > 0], starts, voxel_of, slot_of, slot_starts)


@numba.njit(cache=True)
def _count(boxes, index, per_pair, per_voxel):
    for i in range(len(boxes)):
        if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
            continue
        for ty in range(boxes[i, 2] // TILE_PX, (boxes[i, 3] - 1) // TILE_PX + 1):
            for tx in range(boxes[i, 0] // TILE_PX, (boxes[i, 1] - 1) // TILE_PX + 1):
                for octant in range(OCTANTS):
                    pair = index[ty, tx, octant]
                    if pair >= 0:
                        per_pair[pair] += 1
                        per_voxel[i] += 1


@numba.njit(cache=True, parallel=True)
def _fill(orders, used, boxes, index, cursor, slot_starts, voxel_of, slot_of):
    # Each octant's pairs are its own, and a voxel's slots follow from its box: the octants need not wait for one another.
    for octant in numba.prange(OCTANTS):
        if not used[octant]:
            continue
        for i in orders[octant]:
            if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
                continue
            slot = slot_starts[i]
            for ty in range(boxes[i, 2] // TILE_PX, (boxes[i, 3] - 1) // TILE_PX + 1):
                for tx in range(boxes[i, 0] // TILE_PX, (boxes[i, 1] - 1) // TILE_PX + 1):
                    for other in range(OCTANTS):
                        pair = index[ty, tx, other]
                        if pair < 0:
                            continue
                        if other == octant:
                            voxel_of[cursor[pair]] = i
                            slot_of[cursor[pair]] = slot
                            cursor[pair] += 1
                        slot += 1
