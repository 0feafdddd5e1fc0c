"""The blending kernels of 2D Gaussian Splatting for CUDA: what `rasterize` and `rasterize_backward` do, a thread for each pixel.

A block of 16 x 16 threads draws a tile. Where a ray meets a surfel is the same function as on the CPU. Gradients of a splat are summed over
the tile's pixels in shared memory, in fixed order and without atomics, so that they have the same bytes every run.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

from numba import cuda, float32, int32

from zeroshop_steps.surface.rendering.tile_sums import SHARED_ROWS, fold_row
from zeroshop_steps.surface.rendering.tiling import ACROSS, BLOCK_PX, HALF, ONE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.twodgs.kernels import layout as at
from zeroshop_steps.surface.twodgs.kernels.intersection import HALF_SQRT, intersect_surfel
from zeroshop_steps.surface.twodgs.kernels.layout import SPLAT_WIDTH
from zeroshop_steps.surface.twodgs.kernels.rasterize import ALPHA_MAX, CUT

THREADS = TILE_PX * TILE_PX
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
    rows = cuda.shared.array((SHARED_ROWS, SPLAT_WIDTH), float32)
    met = cuda.shared.array(SHARED_ROWS, int32)
    t = ONE
    red = green = blue = depth = nx = ny = nz = median = spread = m1 = m2 = ZERO
    for first in range(starts[tile], starts[tile + 1], SHARED_ROWS):
        if cuda.syncthreads_count(int32(t >= STOP)) == 0:
            break
        count = min(SHARED_ROWS, starts[tile + 1] - first)
        if thread < count:
            met[thread] = blocks[slot_of[first + thread]]
            for c in range(SPLAT_WIDTH):
                rows[thread, c] = splats[splat_of[first + thread], c]
        cuda.syncthreads()
        for k in range(count):
            if (met[k] >> bit) & 1 == 0 or t < STOP:
                continue
            cx, cy, u1, u2, v1, v2, a1, a2 = at.shape_of(rows, k)
            zc, opacity, own_red, own_green, own_blue, own_nx, own_ny, own_nz = at.look_of(rows, k)
            _, a, r, _, _, _, e = intersect_surfel(px - cx, py - cy, u1, u2, v1, v2, a1, a2)
            alpha = min(opacity * e, ALPHA_MAX)
            if alpha < CUT:
                continue
            z, w = zc * r, t * alpha
            red += w * own_red
            green += w * own_green
            blue += w * own_blue
            depth += w * z
            nx += w * own_nx
            ny += w * own_ny
            nz += w * own_nz
            if t > HALF:
                median = z
            if distortion:
                m = k1 - k2 / zc * a
                spread += w * (m * m * (ONE - t) + m2 - TWO * m * m1)
                m1 += w * m
                m2 += w * m * m
            t -= w
    image[at.OUT_R, y, x], image[at.OUT_G, y, x], image[at.OUT_B, y, x], image[at.OUT_DEPTH, y, x] = red, green, blue, depth
    image[at.OUT_NX, y, x], image[at.OUT_NY, y, x], image[at.OUT_NZ, y, x], image[at.OUT_ALPHA, y, x] = nx, ny, nz, ONE - t
    image[at.OUT_MEDIAN, y, x], image[at.OUT_DISTORTION, y, x], image[at.OUT_M1, y, x], image[at.OUT_M2, y, x] = median, spread, m1, m2


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
    gr, gg, gb, gz = gradient[at.OUT_R, y, x], gradient[at.OUT_G, y, x], gradient[at.OUT_B, y, x], gradient[at.OUT_DEPTH, y, x]
    gnx, gny, gnz, g_alpha = gradient[at.OUT_NX, y, x], gradient[at.OUT_NY, y, x], gradient[at.OUT_NZ, y, x], gradient[at.OUT_ALPHA, y, x]
    g_median, g_distortion = gradient[at.OUT_MEDIAN, y, x], gradient[at.OUT_DISTORTION, y, x]
    all_alpha, last_median, m1, m2 = image[at.OUT_ALPHA, y, x], image[at.OUT_MEDIAN, y, x], image[at.OUT_M1, y, x], image[at.OUT_M2, y, x]
    total = TWO * g_distortion * image[at.OUT_DISTORTION, y, x]
    for plane in range(at.OUT_MEDIAN):
        total += gradient[plane, y, x] * image[plane, y, x]
    t, behind = ONE, ZERO
    for entry in range(starts[tile], starts[tile + 1]):
        slot, i = slot_of[entry], splat_of[entry]
        reached = (blocks[slot] >> bit) & 1 == 1 and t >= STOP
        if cuda.syncthreads_or(int32(reached)) == 0:
            continue
        for c in range(SPLAT_WIDTH):
            sums[c, thread] = ZERO
        cx, cy, u1, u2, v1, v2, a1, a2 = at.shape_of(splats, i)
        zc, opacity, red, green, blue, nx, ny, nz = at.look_of(splats, i)
        dx, dy = px - cx, py - cy
        on_surfel, a, r, u, v, at_surfel, e = intersect_surfel(dx, dy, u1, u2, v1, v2, a1, a2)
        full = opacity * e
        alpha = min(full, ALPHA_MAX)
        if reached and alpha >= CUT:
            z, w = zc * r, t * alpha
            value = gr * red + gg * green + gb * blue + gz * z + g_alpha
            value += gnx * nx + gny * ny + gnz * nz
            d_z = w * gz
            if distortion:
                inverse_z = a / zc
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
            sums[at.OPACITY, thread] = d_log / opacity
            sums[at.RED, thread], sums[at.GREEN, thread], sums[at.BLUE, thread] = w * gr, w * gg, w * gb
            sums[at.NX, thread], sums[at.NY, thread], sums[at.NZ, thread] = w * gnx, w * gny, w * gnz
            sums[at.ZC, thread] = d_zc
            sums[at.U1, thread], sums[at.U2, thread] = _TO_ROOT * d_u * dx, _TO_ROOT * d_u * dy
            sums[at.V1, thread], sums[at.V2, thread] = _TO_ROOT * d_v * dx, _TO_ROOT * d_v * dy
            sums[at.A1, thread], sums[at.A2, thread] = -TWO * d_a * dx, -TWO * d_a * dy
            sums[at.CX, thread] = TWO * (d_u * u1 + d_v * v1 + d_a * a1 + d_pixel * dx)
            sums[at.CY, thread] = TWO * (d_u * u2 + d_v * v2 + d_a * a2 + d_pixel * dy)
        cuda.syncthreads()
        # A thread for each column of the splat's row and row of pixels; then one for each column.
        parts[column, row] = fold_row(sums, column, row * TILE_PX, -1)
        cuda.syncthreads()
        if row == 0:
            slots[slot, column] = fold_row(parts, column, 0, -1)
