"""The depth of the surface that a pixel sees: the mean over the disks near the median one.

The median alone jumps from disk to disk; the mean of all mixes a surface with what lies behind it or hangs before it.
"""

import numba
import numpy as np

from zeroshop_steps.nvs.twodgs.intersection import HALF_SQRT, meet
from zeroshop_steps.nvs.twodgs.project import A1, A2, ALPHA_MIN, CX, CY, OPACITY, U1, U2, V1, V2, ZC
from zeroshop_steps.nvs.twodgs.rasterize import ALPHA_MAX, STOP
from zeroshop_steps.nvs.views import TILE_PX


@numba.njit(cache=True, parallel=True, error_model="numpy")
def mean_near_median(splats, boxes, tiles, starts, splat_of, tiles_x, median, reach, depth):
    """Fill depth (height, width), which must hold zeros, where `median` (height, width) is positive.

    Arguments as in `rasterize.blend_forward`; reach: disks within this of the median depth count, by their blending weights.
    """
    for position in numba.prange(len(tiles)):
        tile = tiles[position]
        left, top = (tile % tiles_x) * TILE_PX, (tile // tiles_x) * TILE_PX
        light = np.ones((TILE_PX, TILE_PX), np.float32)
        total, weight = np.zeros((TILE_PX, TILE_PX), np.float32), np.zeros((TILE_PX, TILE_PX), np.float32)
        for entry in range(starts[tile], starts[tile + 1]):
            s, box = splats[splat_of[entry]], boxes[splat_of[entry]]
            for y in range(max(box[2], top), min(box[3], top + TILE_PX)):
                for x in range(max(box[0], left), min(box[1], left + TILE_PX)):
                    j, i = y - top, x - left
                    if light[j, i] < STOP:
                        continue
                    dx, dy = np.float32(x + 0.5) - s[CX], np.float32(y + 0.5) - s[CY]
                    u1, u2, v1, v2 = s[U1] * HALF_SQRT, s[U2] * HALF_SQRT, s[V1] * HALF_SQRT, s[V2] * HALF_SQRT
                    _, _, r, _, _, _, value = meet(dx, dy, u1, u2, v1, v2, s[A1], s[A2])
                    z = s[ZC] * r
                    alpha = min(s[OPACITY] * value, ALPHA_MAX)
                    if alpha < ALPHA_MIN:
                        continue
                    if abs(z - median[y, x]) <= reach:
                        total[j, i] += light[j, i] * alpha * z
                        weight[j, i] += light[j, i] * alpha
                    light[j, i] *= np.float32(1.0) - alpha
        for j in range(TILE_PX):
            for i in range(TILE_PX):
                if weight[j, i] > 0 and median[top + j, left + i] > 0:
                    depth[top + j, left + i] = total[j, i] / weight[j, i]
