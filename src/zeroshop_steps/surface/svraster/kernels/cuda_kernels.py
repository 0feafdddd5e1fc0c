"""The blending kernels of sparse voxels for CUDA: what `rasterize` and `rasterize_backward` do, a thread for each pixel.

A block of 16 x 16 threads draws a pair of a tile and an octant. Where a ray meets a voxel, and the density there, are the same functions
as on the CPU. Gradients of a voxel are summed over the tile's pixels in shared memory, in fixed order and without atomics, so that they
have the same bytes every run. Rays are set up in double precision, once for each pixel; all else is in single precision.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

import math

from numba import cuda, float32, int32

from zeroshop_steps.surface.rendering.tile_sums import fold_row
from zeroshop_steps.surface.rendering.tiling import HALF, ONE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.svraster.kernels.intersection import exp, expm1, interpolate_density, intersect_voxel
from zeroshop_steps.surface.svraster.kernels.project import (
    A0,
    A1,
    A2,
    B0,
    B1,
    B2,
    BLUE,
    C0,
    C1,
    C2,
    G_NX,
    G_P,
    G_PRIORITY,
    G_RED,
    G_WEIGHT,
    GRADIENT_WIDTH,
    GREEN,
    NX,
    NY,
    NZ,
    P1,
    PX,
    PXY,
    PXYZ,
    PXZ,
    PY,
    PYZ,
    PZ,
    RED,
    ROW_WIDTH,
    SIZE,
    TAU_MIN,
    X0,
    Y0,
    ZC,
)  # fmt: skip
from zeroshop_steps.surface.svraster.kernels.rasterize import (
    DENSITY_SCALE,
    GRAD_PLANES,
    INVERSE_KNEE,
    KNEE,
    LOG2,
    OUT_ALPHA,
    OUT_AWAY,
    OUT_B,
    OUT_DEPTH,
    OUT_G,
    OUT_MEDIAN,
    OUT_NX,
    OUT_NY,
    OUT_NZ,
    OUT_R,
    OUT_SLOPE,
    OUT_SQUARE,
    SAMPLES,
    STEP,
    TINY,
)
from zeroshop_steps.surface.svraster.kernels.tiles import ray_direction

THREADS = TILE_PX * TILE_PX
SHARED_VOXELS = 64  # that a block reads at once
_THICK = float32(DENSITY_SCALE / SAMPLES)


@cuda.jit(device=True)
def _find_segment(row, px, py, d0, d1, d2):
    """Where the ray of a pixel meets the voxel of a row (28,): as `intersect_voxel`."""
    return intersect_voxel(
        px, py, d0, d1, d2, ONE / d0, ONE / d1, ONE / d2, row[X0], row[Y0], row[A0], row[A1], row[A2], row[B0], row[B1], row[B2],
        row[C0], row[C1], row[C2], row[TAU_MIN],
    )  # fmt: skip


@cuda.jit(device=True)
def _value_at(row, u, v, w):
    """The density before activation at a point in the frame of the voxel of a row (28,)."""
    return interpolate_density(u, v, w, row[P1], row[PX], row[PY], row[PZ], row[PXY], row[PXZ], row[PYZ], row[PXYZ])


@cuda.jit(device=True)
def _sum_densities(row, e0, e1, e2, tau, length, d0, d1, d2):
    """Sum of the activated densities at a segment's samples."""
    total = ZERO
    for k in range(SAMPLES):
        at = tau + length * ((float32(k) + HALF) * STEP)
        v = _value_at(row, e0 + at * d0, e1 + at * d1, e2 + at * d2)
        total += v if v > KNEE else KNEE * exp(v * INVERSE_KNEE - ONE)
    return total


@cuda.jit
def blend_forward(rows, boxes, camera, pair_tiles, pair_octants, pixel_octants, starts, voxel_of, tiles_x, image):
    """Draw all pairs, one a block, into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros.

    pixel_octants: (tiles_y * 16, tiles_x * 16) uint8. Other arguments as in `rasterize.blend_forward`.
    """
    pair = cuda.blockIdx.x
    tile, octant = pair_tiles[pair], pair_octants[pair]
    column, row = cuda.threadIdx.x, cuda.threadIdx.y
    x, y = tile % tiles_x * TILE_PX + column, tile // tiles_x * TILE_PX + row
    px, py, thread = float32(x) + HALF, float32(y) + HALF, row * TILE_PX + column
    own = pixel_octants[y, x] == octant
    d0 = float32(ray_direction(camera, x + 0.5, y + 0.5, 0))
    d1 = float32(ray_direction(camera, x + 0.5, y + 0.5, 1))
    d2 = float32(ray_direction(camera, x + 0.5, y + 0.5, 2))
    ray_x, ray_y = float32((x + 0.5 - camera[14]) / camera[12]), float32((y + 0.5 - camera[15]) / camera[13])
    ray_length = float32(math.sqrt(d0 * d0 + d1 * d1 + d2 * d2))
    shared = cuda.shared.array((SHARED_VOXELS, ROW_WIDTH), float32)
    bounds = cuda.shared.array((SHARED_VOXELS, 4), int32)
    t = ONE if own else ZERO
    red = green = blue = depth = nx = ny = nz = median = squared = away = slope = before = ZERO
    for first in range(starts[pair], starts[pair + 1], SHARED_VOXELS):
        if cuda.syncthreads_count(int32(t >= STOP)) == 0:
            break
        count = min(SHARED_VOXELS, starts[pair + 1] - first)
        if thread < count:
            voxel = voxel_of[first + thread]
            for c in range(4):
                bounds[thread, c] = boxes[voxel, c]
            for c in range(ROW_WIDTH):
                shared[thread, c] = rows[voxel, c]
        cuda.syncthreads()
        for k in range(count):
            if t < STOP or x < bounds[k, 0] or x >= bounds[k, 1] or y < bounds[k, 2] or y >= bounds[k, 3]:
                continue
            s = shared[k]
            e0, e1, e2, tau, length = _find_segment(s, px, py, d0, d1, d2)
            along = length * s[SIZE]
            thick = _sum_densities(s, e0, e1, e2, tau, length, d0, d1, d2) * along * (ray_length * _THICK)
            w = -t * expm1(-thick)
            red += w * s[RED]
            green += w * s[GREEN]
            blue += w * s[BLUE]
            depth += w * (s[ZC] + s[SIZE] * (tau + HALF * length))
            nx += w * s[NX]
            ny += w * s[NY]
            nz += w * s[NZ]
            squared += w * (s[RED] * s[RED] + s[GREEN] * s[GREEN] + s[BLUE] * s[BLUE])
            away += w * max((s[NX] * ray_x + s[NY] * ray_y + s[NZ]) / ray_length, ZERO)
            if before < LOG2 and before + thick >= LOG2:
                slope = along / max(thick, TINY)
                median = s[ZC] + s[SIZE] * tau + slope * (LOG2 - before)
            before += thick
            t -= w
    if own:
        image[OUT_R, y, x], image[OUT_G, y, x], image[OUT_B, y, x], image[OUT_DEPTH, y, x] = red, green, blue, depth
        image[OUT_NX, y, x], image[OUT_NY, y, x], image[OUT_NZ, y, x], image[OUT_ALPHA, y, x] = nx, ny, nz, ONE - t
        image[OUT_MEDIAN, y, x], image[OUT_SQUARE, y, x], image[OUT_AWAY, y, x], image[OUT_SLOPE, y, x] = median, squared, away, slope


@cuda.jit
def blend_backward(
    rows, boxes, camera, pair_tiles, pair_octants, pixel_octants, starts, voxel_of, slot_of, tiles_x, image, gradient, slots
):
    """Gradients by the voxel rows of each pair, summed over its pixels, into slots (E, 16) float32, which must hold zeros.

    Arguments as in `rasterize_backward.blend_backward`; its docstring has the equations. The last two columns are the largest blending
    weight and the priority.
    """
    pair = cuda.blockIdx.x
    tile, octant = pair_tiles[pair], pair_octants[pair]
    column, row = cuda.threadIdx.x, cuda.threadIdx.y
    x, y = tile % tiles_x * TILE_PX + column, tile // tiles_x * TILE_PX + row
    px, py, thread = float32(x) + HALF, float32(y) + HALF, row * TILE_PX + column
    d0 = float32(ray_direction(camera, x + 0.5, y + 0.5, 0))
    d1 = float32(ray_direction(camera, x + 0.5, y + 0.5, 1))
    d2 = float32(ray_direction(camera, x + 0.5, y + 0.5, 2))
    ray_x, ray_y = float32((x + 0.5 - camera[14]) / camera[12]), float32((y + 0.5 - camera[15]) / camera[13])
    ray_length = float32(math.sqrt(d0 * d0 + d1 * d1 + d2 * d2))
    sums = cuda.shared.array((GRADIENT_WIDTH, THREADS), float32)
    parts = cuda.shared.array((GRADIENT_WIDTH, TILE_PX), float32)
    gr, gg, gb, gz = gradient[OUT_R, y, x], gradient[OUT_G, y, x], gradient[OUT_B, y, x], gradient[OUT_DEPTH, y, x]
    gnx, gny, gnz, g_alpha = gradient[OUT_NX, y, x], gradient[OUT_NY, y, x], gradient[OUT_NZ, y, x], gradient[OUT_ALPHA, y, x]
    g_median, g_square, g_away = gradient[OUT_MEDIAN, y, x], gradient[OUT_SQUARE, y, x], gradient[OUT_AWAY, y, x]
    by_thickness = g_median * image[OUT_SLOPE, y, x]
    total = ZERO
    for plane in range(GRAD_PLANES):
        if plane != OUT_MEDIAN:
            total += gradient[plane, y, x] * image[plane, y, x]
    t, through, before = ONE if pixel_octants[y, x] == octant else ZERO, ZERO, ZERO
    for entry in range(starts[pair], starts[pair + 1]):
        voxel = voxel_of[entry]
        reached = t >= STOP and boxes[voxel, 0] <= x and x < boxes[voxel, 1] and boxes[voxel, 2] <= y and y < boxes[voxel, 3]
        if cuda.syncthreads_or(int32(reached)) == 0:
            continue
        for c in range(GRADIENT_WIDTH):
            sums[c, thread] = ZERO
        if reached:
            s = rows[voxel]
            e0, e1, e2, tau, length = _find_segment(s, px, py, d0, d1, d2)
            per_value = length * s[SIZE] * (ray_length * _THICK)
            thick = _sum_densities(s, e0, e1, e2, tau, length, d0, d1, d2) * per_value
            alpha = -expm1(-thick)
            w = t * alpha
            cosine = (s[NX] * ray_x + s[NY] * ray_y + s[NZ]) / ray_length
            value = gr * s[RED] + gg * s[GREEN] + gb * s[BLUE] + gnx * s[NX] + gny * s[NY] + gnz * s[NZ] + g_alpha
            value += g_square * (s[RED] * s[RED] + s[GREEN] * s[GREEN] + s[BLUE] * s[BLUE]) + g_away * max(cosine, ZERO)
            value += gz * (s[ZC] + s[SIZE] * (tau + HALF * length))
            through += w * value
            by_thick = (t - w) * value - (total - through)
            # The depth at which half of the light is gone moves nearer with every thickness before it.
            if before < LOG2:
                by_thick -= by_thickness * (ONE if before + thick < LOG2 else (LOG2 - before) / max(thick, TINY))
            before += thick
            t -= w
            for k in range(SAMPLES):
                at = tau + length * ((float32(k) + HALF) * STEP)
                u0, u1, u2 = e0 + at * d0, e1 + at * d1, e2 + at * d2
                v = _value_at(s, u0, u1, u2)
                by_value = by_thick * per_value * (ONE if v > KNEE else exp(v * INVERSE_KNEE - ONE))
                sums[G_P, thread] += by_value
                sums[G_P + 1, thread] += by_value * u0
                sums[G_P + 2, thread] += by_value * u1
                sums[G_P + 3, thread] += by_value * u2
                sums[G_P + 4, thread] += by_value * (u0 * u1)
                sums[G_P + 5, thread] += by_value * (u0 * u2)
                sums[G_P + 6, thread] += by_value * (u1 * u2)
                sums[G_P + 7, thread] += by_value * (u0 * u1 * u2)
            sums[G_RED, thread] = w * (gr + TWO * g_square * s[RED])
            sums[G_RED + 1, thread] = w * (gg + TWO * g_square * s[GREEN])
            sums[G_RED + 2, thread] = w * (gb + TWO * g_square * s[BLUE])
            by_cosine = w * g_away / ray_length if cosine > ZERO else ZERO
            sums[G_NX, thread] = w * gnx + by_cosine * ray_x
            sums[G_NX + 1, thread] = w * gny + by_cosine * ray_y
            sums[G_NX + 2, thread] = w * gnz + by_cosine
            sums[G_WEIGHT, thread] = w
            # |alpha d loss / d alpha|, where d alpha = exp(-x) dx.
            sums[G_PRIORITY, thread] = abs(by_thick) * alpha / max(ONE - alpha, STOP)
        cuda.syncthreads()
        # A thread for each column of the voxel's row and row of pixels; then one for each column.
        parts[column, row] = fold_row(sums, column, row * TILE_PX, G_WEIGHT)
        cuda.syncthreads()
        if row == 0:
            slots[slot_of[entry], column] = fold_row(parts, column, 0, G_WEIGHT)
