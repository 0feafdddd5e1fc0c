"""The blending kernels of 2D Gaussian Splatting for CUDA: what `rasterize` and `rasterize_backward` do, a thread for each pixel.

A block of 16 x 16 threads draws a tile. Where a ray meets a surfel is the same function as on the CPU. Gradients of a splat are summed over
the tile's pixels in shared memory, in fixed order and without atomics, so that they have the same bytes every run.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

from numba import cuda, float32, int32

from zeroshop_steps.surface.rendering.tile_sums import fold_row
from zeroshop_steps.surface.rendering.tiling import ACROSS, BLOCK_PX, HALF, ONE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.twodgs.kernels.intersection import HALF_SQRT, intersect_surfel
from zeroshop_steps.surface.twodgs.kernels.project import (
    A1,
    A2,
    BLUE,
    CX,
    CY,
    GREEN,
    NX,
    NY,
    NZ,
    OPACITY,
    RED,
    SPLAT_WIDTH,
    U1,
    U2,
    V1,
    V2,
    ZC,
)  # fmt: skip
from zeroshop_steps.surface.twodgs.kernels.rasterize import (
    ALPHA_MAX,
    CUT,
    OUT_ALPHA,
    OUT_B,
    OUT_DEPTH,
    OUT_DISTORTION,
    OUT_G,
    OUT_M1,
    OUT_M2,
    OUT_MEDIAN,
    OUT_NX,
    OUT_NY,
    OUT_NZ,
    OUT_R,
)

THREADS = TILE_PX * TILE_PX
SHARED_SPLATS = 64  # that a block reads at once
_TO_ROOT = -TWO * HALF_SQRT


@cuda.jit
def blend_forward(splats, starts, splat_of, slot_of, blocks, tiles_x, distortion, k1, k2, image):
    """Draw all tiles, one a block, into image (12, tiles_y * 16, tiles_x * 16) float32.

    Arguments as in `rasterize.blend_forward`; the blocks are not changed.
    """
    tile = cuda.blockIdx.x
    column, row = cuda.threadIdx.x, cuda.threadIdx.y
    x, y = tile % tiles_x * TILE_PX + column, tile // tiles_x * TILE_PX + row
    px, py = float32(x) + HALF, float32(y) + HALF
    thread, bit = row * TILE_PX + column, row // BLOCK_PX * ACROSS + column // BLOCK_PX
    rows = cuda.shared.array((SHARED_SPLATS, SPLAT_WIDTH), float32)
    met = cuda.shared.array(SHARED_SPLATS, int32)
    t = ONE
    red = green = blue = depth = nx = ny = nz = median = spread = m1 = m2 = ZERO
    for first in range(starts[tile], starts[tile + 1], SHARED_SPLATS):
        if cuda.syncthreads_count(int32(t >= STOP)) == 0:
            break
        count = min(SHARED_SPLATS, starts[tile + 1] - first)
        if thread < count:
            met[thread] = blocks[slot_of[first + thread]]
            for c in range(SPLAT_WIDTH):
                rows[thread, c] = splats[splat_of[first + thread], c]
        cuda.syncthreads()
        for k in range(count):
            if (met[k] >> bit) & 1 == 0 or t < STOP:
                continue
            _, a, r, _, _, _, e = intersect_surfel(
                px - rows[k, CX], py - rows[k, CY], rows[k, U1] * HALF_SQRT, rows[k, U2] * HALF_SQRT, rows[k, V1] * HALF_SQRT,
                rows[k, V2] * HALF_SQRT, rows[k, A1], rows[k, A2],
            )  # fmt: skip
            alpha = min(rows[k, OPACITY] * e, ALPHA_MAX)
            if alpha < CUT:
                continue
            z, w = rows[k, ZC] * r, t * alpha
            red += w * rows[k, RED]
            green += w * rows[k, GREEN]
            blue += w * rows[k, BLUE]
            depth += w * z
            nx += w * rows[k, NX]
            ny += w * rows[k, NY]
            nz += w * rows[k, NZ]
            if t > HALF:
                median = z
            if distortion:
                m = k1 - k2 / rows[k, ZC] * a
                spread += w * (m * m * (ONE - t) + m2 - TWO * m * m1)
                m1 += w * m
                m2 += w * m * m
            t -= w
    image[OUT_R, y, x], image[OUT_G, y, x], image[OUT_B, y, x], image[OUT_DEPTH, y, x] = red, green, blue, depth
    image[OUT_NX, y, x], image[OUT_NY, y, x], image[OUT_NZ, y, x], image[OUT_ALPHA, y, x] = nx, ny, nz, ONE - t
    image[OUT_MEDIAN, y, x], image[OUT_DISTORTION, y, x], image[OUT_M1, y, x], image[OUT_M2, y, x] = median, spread, m1, m2


@cuda.jit
def blend_backward(splats, starts, splat_of, slot_of, blocks, tiles_x, distortion, k1, k2, image, gradient, slots):
    """Gradients by the splat rows of each tile, summed over its pixels, into slots (S, 16) float32, which must hold zeros.

    Arguments as in `rasterize_backward.blend_backward`; its docstring has the equations.
    """
    tile = cuda.blockIdx.x
    column, row = cuda.threadIdx.x, cuda.threadIdx.y
    x, y = tile % tiles_x * TILE_PX + column, tile // tiles_x * TILE_PX + row
    px, py = float32(x) + HALF, float32(y) + HALF
    thread, bit = row * TILE_PX + column, row // BLOCK_PX * ACROSS + column // BLOCK_PX
    sums = cuda.shared.array((SPLAT_WIDTH, THREADS), float32)
    parts = cuda.shared.array((SPLAT_WIDTH, TILE_PX), float32)
    gr, gg, gb, gz = gradient[OUT_R, y, x], gradient[OUT_G, y, x], gradient[OUT_B, y, x], gradient[OUT_DEPTH, y, x]
    gnx, gny, gnz, g_alpha = gradient[OUT_NX, y, x], gradient[OUT_NY, y, x], gradient[OUT_NZ, y, x], gradient[OUT_ALPHA, y, x]
    g_median, g_distortion = gradient[OUT_MEDIAN, y, x], gradient[OUT_DISTORTION, y, x]
    all_alpha, last_median, m1, m2 = image[OUT_ALPHA, y, x], image[OUT_MEDIAN, y, x], image[OUT_M1, y, x], image[OUT_M2, y, x]
    total = TWO * g_distortion * image[OUT_DISTORTION, y, x]
    for plane in range(OUT_MEDIAN):
        total += gradient[plane, y, x] * image[plane, y, x]
    t, behind = ONE, ZERO
    for entry in range(starts[tile], starts[tile + 1]):
        slot, i = slot_of[entry], splat_of[entry]
        reached = (blocks[slot] >> bit) & 1 == 1 and t >= STOP
        if cuda.syncthreads_or(int32(reached)) == 0:
            continue
        for c in range(SPLAT_WIDTH):
            sums[c, thread] = ZERO
        dx, dy = px - splats[i, CX], py - splats[i, CY]
        u1, u2, v1, v2 = splats[i, U1] * HALF_SQRT, splats[i, U2] * HALF_SQRT, splats[i, V1] * HALF_SQRT, splats[i, V2] * HALF_SQRT
        a1, a2, opacity = splats[i, A1], splats[i, A2], splats[i, OPACITY]
        on_surfel, a, r, u, v, at_surfel, e = intersect_surfel(dx, dy, u1, u2, v1, v2, a1, a2)
        full = opacity * e
        alpha = min(full, ALPHA_MAX)
        if reached and alpha >= CUT:
            z, w = splats[i, ZC] * r, t * alpha
            value = gr * splats[i, RED] + gg * splats[i, GREEN] + gb * splats[i, BLUE] + gz * z + g_alpha
            value += gnx * splats[i, NX] + gny * splats[i, NY] + gnz * splats[i, NZ]
            d_z = w * gz
            if distortion:
                inverse_z = a / splats[i, ZC]
                m = k1 - k2 * inverse_z
                value += g_distortion * (m * m * all_alpha + m2 - TWO * m * m1)
                d_z += g_distortion * TWO * w * (m * all_alpha - m1) * k2 * inverse_z * inverse_z
            behind += w * value
            if t > HALF and z == last_median:
                d_z += g_median
            # Times alpha, which is opacity times the Gaussian: the derivative by the logarithm of either.
            d_log = alpha * (t * value - (total - behind) / (ONE - alpha)) if full <= ALPHA_MAX else ZERO
            t -= w
            d_zc = d_z * r
            d_surfel = d_log * r if on_surfel else ZERO
            d_u, d_v = d_surfel * u, d_surfel * v
            d_a = d_zc * HALF * z - d_surfel * at_surfel if on_surfel else ZERO
            d_pixel = ZERO if on_surfel else d_log
            sums[OPACITY, thread] = d_log / opacity
            sums[RED, thread], sums[GREEN, thread], sums[BLUE, thread] = w * gr, w * gg, w * gb
            sums[NX, thread], sums[NY, thread], sums[NZ, thread] = w * gnx, w * gny, w * gnz
            sums[ZC, thread] = d_zc
            sums[U1, thread], sums[U2, thread] = _TO_ROOT * d_u * dx, _TO_ROOT * d_u * dy
            sums[V1, thread], sums[V2, thread] = _TO_ROOT * d_v * dx, _TO_ROOT * d_v * dy
            sums[A1, thread], sums[A2, thread] = -TWO * d_a * dx, -TWO * d_a * dy
            sums[CX, thread] = TWO * (d_u * u1 + d_v * v1 + d_a * a1 + d_pixel * dx)
            sums[CY, thread] = TWO * (d_u * u2 + d_v * v2 + d_a * a2 + d_pixel * dy)
        cuda.syncthreads()
        # A thread for each column of the splat's row and row of pixels; then one for each column.
        parts[column, row] = fold_row(sums, column, row * TILE_PX, -1)
        cuda.syncthreads()
        if row == 0:
            slots[slot, column] = fold_row(parts, column, 0, -1)
