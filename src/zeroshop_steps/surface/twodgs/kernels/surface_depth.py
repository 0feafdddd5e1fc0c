"""The depth of the surface that a pixel sees: the mean over the surfels near the median depth.

The median alone jumps from surfel to surfel. The mean of all mixes a surface with what lies behind it or floats before it.
"""

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import ACROSS, BIT, BLOCK_PX, BLOCKS, LANES, PLANE, STOP, TILE_PX, ZERO
from zeroshop_steps.surface.twodgs.kernels import layout as at
from zeroshop_steps.surface.twodgs.kernels.intersection import intersect_surfel
from zeroshop_steps.surface.twodgs.kernels.rasterize import ALPHA_MAX, CUT, load_pixels

# Planes of a block's buffer: x, y, transmittance, median depth, weighted depth, weight.
_T, _MEDIAN, _TOTAL, _WEIGHT = 2, 3, 4, 5
_PLANES = 6


@numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
def _add_splat(splats, index, b, blocks, reach):
    """Add splat `index` to some blocks (one bit a block) of a tile's buffer."""
    cx, cy, u1, u2, v1, v2, a1, a2 = at.shape_of(splats, index)
    zc, opacity = splats[index, at.ZC], splats[index, at.OPACITY]
    while blocks:
        rest = blocks & (blocks - np.uint64(1))
        first = BIT[(blocks ^ rest) % np.uint64(19)] * np.uint64(_PLANES * LANES)
        blocks = rest
        for i in range(first, first + np.uint64(LANES)):
            _, _, r, _, _, _, e = intersect_surfel(b[i] - cx, b[i + PLANE[1]] - cy, u1, u2, v1, v2, a1, a2)
            z = zc * r
            alpha = min(opacity * e, ALPHA_MAX)
            t = b[i + PLANE[_T]]
            stopped = t * alpha if (alpha >= CUT) & (t >= STOP) else ZERO
            w = stopped if abs(z - b[i + PLANE[_MEDIAN]]) <= reach else ZERO
            b[i + PLANE[_TOTAL]] += w * z
            b[i + PLANE[_WEIGHT]] += w
            b[i + PLANE[_T]] = t - stopped


@numba.njit(cache=True, parallel=True, error_model="numpy")
def mean_near_median(splats, tiles, starts, splat_of, slot_of, blocks, tiles_x, workers, median, reach, depth):
    """Fill depth (height, width), which must hold zeros, where `median` (height, width) is positive.

    Arguments as in `rasterize.blend_forward`, which has thinned the blocks; reach: surfels within this of the median depth count, by
    their blending weights.
    """
    for worker in numba.prange(workers):
        b = np.empty(_PLANES * LANES * BLOCKS, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            b[:] = 0.0
            load_pixels(b, _PLANES, tile_x, tile_y)
            for block in range(BLOCKS):
                y0, x0 = tile_y * TILE_PX + block // ACROSS * BLOCK_PX, tile_x * TILE_PX + block % ACROSS * BLOCK_PX
                for lane in range(LANES):
                    b[(block * _PLANES + _MEDIAN) * LANES + lane] = median[y0 + lane // BLOCK_PX, x0 + lane % BLOCK_PX]
            for entry in range(starts[tile], starts[tile + 1]):
                met = np.uint64(blocks[slot_of[entry]])
                if met:
                    _add_splat(splats, splat_of[entry], b, met, reach)
            for block in range(BLOCKS):
                y0, x0 = tile_y * TILE_PX + block // ACROSS * BLOCK_PX, tile_x * TILE_PX + block % ACROSS * BLOCK_PX
                for lane in range(LANES):
                    start = block * _PLANES * LANES + lane
                    weight = b[start + _WEIGHT * LANES]
                    if weight > ZERO and b[start + _MEDIAN * LANES] > ZERO:
                        depth[y0 + lane // BLOCK_PX, x0 + lane % BLOCK_PX] = b[start + _TOTAL * LANES] / weight
