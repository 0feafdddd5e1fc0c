"""Which splats each tile of the image shows, front to back, and in which of its blocks.

A tile of 16 x 16 pixels consists of 16 blocks of 4 x 4. A splat's footprint is an ellipse and a circle around its centre:
in four rows of pixels at a time it reaches from its leftmost point in them to its rightmost one, which gives the blocks that it meets.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import ACROSS, BLOCK_PX, TILE_PX, tiles_of
from zeroshop_steps.surface.twodgs.kernels import layout as at
from zeroshop_steps.surface.twodgs.kernels.project import MARGIN_PX

_FAR, _TINY = np.float32(1e30), np.float32(1e-6)


@dataclass(frozen=True)
class TileLists:
    """The splats of each active tile, sorted by depth of their centres.

    Attributes:
        tiles: (T,) indices of the active, non-empty tiles, longest list first, so that threads finish together.
        starts: (tiles_x * tiles_y + 1,) where each tile's list begins in `splat_of` and `slot_of`.
        splat_of: (I,) index of the splat of each list entry.
        slot_of: (I,) row where that entry's blocks, and later its gradient, are stored; the rows of one splat lie together.
        slot_starts: (N + 1,) first row of each splat; it has one for each tile that its box meets.
        blocks: (S,) uint16 for each row, the blocks of the tile that the splat may be seen in: bit 4 y + x.
    """

    tiles: np.ndarray
    starts: np.ndarray
    splat_of: np.ndarray
    slot_of: np.ndarray
    slot_starts: np.ndarray
    blocks: np.ndarray


def list_splats_by_tile(splats: np.ndarray, outlines: np.ndarray, boxes: np.ndarray, tile_active: np.ndarray, workers: int) -> TileLists:
    """Sort splats into tiles.

    Args:
        splats: (N, 16) float32, outlines: (N, 6) float32, boxes: (N, 4) int32 as `project_forward` left them.
        tile_active: (tiles_y, tiles_x) bool; other tiles are neither drawn nor differentiated.
        workers: number of threads.
    """
    slot_starts = np.zeros(len(boxes) + 1, np.int32)
    _count_slots(boxes, slot_starts[1:])
    np.cumsum(slot_starts, out=slot_starts)
    blocks = np.zeros(slot_starts[-1], np.uint16)
    _mark_blocks(splats, outlines, boxes, tile_active, slot_starts, workers, blocks)
    order = _front_to_back(splats[:, at.ZC])
    per_tile = np.zeros(tile_active.size, np.int32)
    _count(order, boxes, slot_starts, blocks, tile_active.shape[1], workers, per_tile)
    starts = np.concatenate([[0], np.cumsum(per_tile)])
    splat_of, slot_of = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.int32)
    _fill(order, boxes, slot_starts, blocks, tile_active.shape[1], workers, starts[:-1].copy(), splat_of, slot_of)
    tiles = np.argsort(-per_tile, kind="stable")
    return TileLists(tiles[per_tile[tiles] > 0], starts, splat_of, slot_of, slot_starts, blocks)


def _front_to_back(depths: np.ndarray) -> np.ndarray:
    """(N,) stable order of (N,) non-negative float32 depths: their bits rise with them, and numpy sorts 16 bits by counting."""
    bits = np.ascontiguousarray(depths).view(np.uint32)
    order = np.argsort(bits.astype(np.uint16), kind="stable")
    return order[np.argsort((bits >> 16).astype(np.uint16)[order], kind="stable")].astype(np.int32)


@numba.njit(cache=True)
def _count_slots(boxes, counts):
    for i in range(len(boxes)):
        left, right, top, bottom = tiles_of(boxes, i)
        counts[i] = (right - left) * (bottom - top)


@numba.njit(inline="always", error_model="numpy")
def mark_splat(splats, outlines, boxes, tile_active, slot_starts, i, width_px, blocks):
    """Set the bits of the blocks that splat i meets, in active tiles; width_px: float32, that of all tiles."""
    one, zero, half_px = np.float32(1.0), np.float32(0.0), np.float32(0.5 - MARGIN_PX)
    tile_left, tile_right, tile_top, tile_bottom = tiles_of(boxes, i)
    if tile_left >= tile_right:
        return
    mid_x, mid_y, half_x, half_y = outlines[i, at.MID_X], outlines[i, at.MID_Y], outlines[i, at.HALF_X], outlines[i, at.HALF_Y]
    covariance, low_pass = outlines[i, at.COVARIANCE], outlines[i, at.LOW_PASS]
    everywhere = half_x == np.inf
    # The ellipse's edges are at x = middle + slope s -+ half sqrt(1 - s^2), s along y from -1 to 1; they are
    # farthest to the right at s = farthest, and to the left at -farthest.
    inverse = one / max(half_y, _TINY)
    slope = covariance * inverse
    half = math.sqrt(max(half_x * half_x - slope * slope, zero))
    farthest = slope / max(half_x, _TINY)
    for band in range(boxes[i, 2] // BLOCK_PX, (boxes[i, 3] - 1) // BLOCK_PX + 1):
        left, right = _FAR, -_FAR
        # Pixel j's centre is at j + 0.5.
        first_y = np.float32(band * BLOCK_PX) + half_px - splats[i, at.CY]
        last_y = np.float32(band * BLOCK_PX + BLOCK_PX) - half_px - splats[i, at.CY]
        top, bottom = (first_y - mid_y) * inverse, (last_y - mid_y) * inverse
        if (top <= one) & (bottom >= -one):
            s = min(max(farthest, top), bottom)
            right = mid_x + slope * s + half * math.sqrt(max(one - s * s, zero))
            s = min(max(-farthest, top), bottom)
            left = mid_x + slope * s - half * math.sqrt(max(one - s * s, zero))
        off = max(max(first_y, -last_y), zero)
        if off <= low_pass:
            reach = math.sqrt(low_pass * low_pass - off * off)
            left, right = min(left, -reach), max(right, reach)
        if everywhere:
            left, right = -_FAR, _FAR
        left = min(max(splats[i, at.CX] + left - one + half_px, zero), width_px)
        right = min(max(splats[i, at.CX] + right - half_px, -one), width_px)
        first, last = max(int(math.ceil(left)), boxes[i, 0]), min(int(math.floor(right)), boxes[i, 1] - 1)
        if first > last:
            continue
        ty, shift = band // ACROSS, band % ACROSS * ACROSS
        slot = slot_starts[i] + (ty - tile_top) * (tile_right - tile_left) - tile_left
        for tx in range(first // TILE_PX, last // TILE_PX + 1):
            low, high = max(first // BLOCK_PX - tx * ACROSS, 0), min(last // BLOCK_PX - tx * ACROSS, ACROSS - 1)
            if tile_active[ty, tx]:
                blocks[slot + tx] |= np.uint16(((2 << high) - (1 << low)) << shift)


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _mark_blocks(splats, outlines, boxes, tile_active, slot_starts, workers, blocks):
    width_px = np.float32(tile_active.shape[1] * TILE_PX)
    for worker in numba.prange(workers):
        for i in range(worker * len(boxes) // workers, (worker + 1) * len(boxes) // workers):
            mark_splat(splats, outlines, boxes, tile_active, slot_starts, i, width_px, blocks)


@numba.njit(cache=True, parallel=True)
def _count(order, boxes, slot_starts, blocks, tiles_x, workers, per_tile):
    # Every worker looks at all splats, and counts (or lists) those in its own rows of tiles: no order depends on their number.
    for worker in numba.prange(workers):
        for i in order:
            left, right, top, bottom = tiles_of(boxes, i)
            for ty in range(top + (worker - top) % workers, bottom, workers):
                slot = slot_starts[i] + (ty - top) * (right - left)
                for tx in range(left, right):
                    if blocks[slot + tx - left]:
                        per_tile[ty * tiles_x + tx] += 1


@numba.njit(cache=True, parallel=True)
def _fill(order, boxes, slot_starts, blocks, tiles_x, workers, cursor, splat_of, slot_of):
    for worker in numba.prange(workers):
        for i in order:
            left, right, top, bottom = tiles_of(boxes, i)
            for ty in range(top + (worker - top) % workers, bottom, workers):
                slot = slot_starts[i] + (ty - top) * (right - left)
                for tx in range(left, right):
                    if blocks[slot + tx - left]:
                        at = cursor[ty * tiles_x + tx]
                        splat_of[at], slot_of[at] = i, slot + tx - left
                        cursor[ty * tiles_x + tx] = at + 1
