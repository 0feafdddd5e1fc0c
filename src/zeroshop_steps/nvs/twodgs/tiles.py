"""Which splats touch which tile of the image, front to back."""

from dataclasses import dataclass

import numba
import numpy as np

from zeroshop_steps.nvs.twodgs.project import ZC
from zeroshop_steps.nvs.views import TILE_PX


@dataclass(frozen=True)
class TileLists:
    """The splats of each active tile, sorted by depth of their centres.

    Attributes:
        tiles: (T,) indices of the active, non-empty tiles, longest list first, so that threads finish together.
        starts: (tiles_x * tiles_y + 1,) where each tile's list begins in `splat_of` and `slot_of`.
        splat_of: (I,) index of the splat of each list entry.
        slot_of: (I,) row where that entry's gradient is stored; the rows of one splat lie together.
        slot_starts: (N + 1,) first row of each splat.
    """

    tiles: np.ndarray
    starts: np.ndarray
    splat_of: np.ndarray
    slot_of: np.ndarray
    slot_starts: np.ndarray


def list_tiles(splats: np.ndarray, boxes: np.ndarray, tile_active: np.ndarray) -> TileLists:
    """Sort splats into tiles.

    Args:
        splats: (N, 16) float32 rows of `project`.
        boxes: (N, 4) int32 pixel boxes x0, x1, y0, y1.
        tile_active: (tiles_y, tiles_x) bool; other tiles are neither drawn nor differentiated.
    """
    order = np.argsort(splats[:, ZC], kind="stable")
    per_tile = np.zeros(tile_active.size, np.int64)
    per_splat = np.zeros(len(splats), np.int64)
    _count(boxes, tile_active, per_tile, per_splat)
    starts = np.concatenate([[0], np.cumsum(per_tile)])
    slot_starts = np.concatenate([[0], np.cumsum(per_splat)])
    splat_of, slot_of = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.int32)
    _fill(order, boxes, tile_active, starts[:-1].copy(), slot_starts, splat_of, slot_of)
    tiles = np.argsort(-per_tile, kind="stable")
    return TileLists(tiles[per_tile[tiles] > 0], starts, splat_of, slot_of, slot_starts)


@numba.njit(cache=True)
def _count(boxes, tile_active, per_tile, per_splat):
    tiles_x = tile_active.shape[1]
    for i in range(len(boxes)):
        if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
            continue
        for ty in range(boxes[i, 2] // TILE_PX, (boxes[i, 3] - 1) // TILE_PX + 1):
            for tx in range(boxes[i, 0] // TILE_PX, (boxes[i, 1] - 1) // TILE_PX + 1):
                if tile_active[ty, tx]:
                    per_tile[ty * tiles_x + tx] += 1
                    per_splat[i] += 1


@numba.njit(cache=True)
def _fill(order, boxes, tile_active, cursor, slot_starts, splat_of, slot_of):
    tiles_x = tile_active.shape[1]
    for i in order:
        if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
            continue
        slot = slot_starts[i]
        for ty in range(boxes[i, 2] // TILE_PX, (boxes[i, 3] - 1) // TILE_PX + 1):
            for tx in range(boxes[i, 0] // TILE_PX, (boxes[i, 1] - 1) // TILE_PX + 1):
                if tile_active[ty, tx]:
                    tile = ty * tiles_x + tx
                    splat_of[cursor[tile]] = i
                    slot_of[cursor[tile]] = slot
                    cursor[tile] += 1
                    slot += 1
