"""The blending kernels of sparse voxels for CUDA: what `rasterize` and `rasterize_backward` do, a thread for each pixel.

A block of 16 x 16 threads draws a pair of a tile and an octant. Where a ray meets a voxel, and the density there, are the same functions
as on the CPU. Gradients of a voxel are summed over the tile's pixels in shared memory, in fixed order and without atomics, so that they
have the same bytes every run. Rays are set up in double precision, once for each pixel; all else is in single precision.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

import math

from numba import cuda, float32, int32

from zeroshop_steps.surface.rendering.tile_sums import SHARED_ROWS, fold_row
from zeroshop_steps.surface.rendering.tiling import HALF, ONE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.svraster.kernels import layout as at
from zeroshop_steps.surface.svraster.kernels.intersection import (
    DENSITY_SCALE,
    SAMPLES,
    activation_slope,
    expm1,
    interpolate_density,
    intersect_voxel,
    sample_at,
    sum_densities,
)
from zeroshop_steps.surface.svraster.kernels.layout import GRAD_PLANES, GRADIENT_WIDTH, ROW_WIDTH
from zeroshop_steps.surface.svraster.kernels.rasterize import LOG2, TINY
from zeroshop_steps.surface.svraster.kernels.tiles import ray_direction

THREADS = TILE_PX * TILE_PX
_THICK = float32(DENSITY_SCALE / SAMPLES)


@cuda.jit
def blend_forward(rows, boxes, camera, pair_tiles, pair_octants, pixel_octants, starts, voxel_of, tiles_x, image):
    """Draw all pairs, one a block, into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros.

    pixel_octants: (tiles_y * 16, tiles_x * 16) uint8. Other arguments as in `rasterize.blend_forward`.
    """
    pair = cuda.blockIdx.x
    tile, octant = pair_tiles[pair], pair_octants[pair]
    column, row = cuda.threadIdx.x, cuda.threadIdx.y
    x, y = tile % tiles_x * TILE_PX + column, tile // tiles_x * TILE_PX + row
    centre_x, centre_y, thread = float32(x) + HALF, float32(y) + HALF, row * TILE_PX + column
    own = pixel_octants[y, x] == octant
    d0 = float32(ray_direction(camera, x + 0.5, y + 0.5, 0))
    d1 = float32(ray_direction(camera, x + 0.5, y + 0.5, 1))
    d2 = float32(ray_direction(camera, x + 0.5, y + 0.5, 2))
    ray_x, ray_y = float32((x + 0.5 - camera[14]) / camera[12]), float32((y + 0.5 - camera[15]) / camera[13])
    ray_length = float32(math.sqrt(d0 * d0 + d1 * d1 + d2 * d2))
    shared = cuda.shared.array((SHARED_ROWS, ROW_WIDTH), float32)
    bounds = cuda.shared.array((SHARED_ROWS, 4), int32)
    t = ONE if own else ZERO
    red = green = blue = depth = nx = ny = nz = median = squared = away = slope = before = ZERO
    for first in range(starts[pair], starts[pair + 1], SHARED_ROWS):
        if cuda.syncthreads_count(int32(t >= STOP)) == 0:
            break
        count = min(SHARED_ROWS, starts[pair + 1] - first)
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
            x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min = at.box_of(shared, k)
            p1, px, py, pz, pxy, pxz, pyz, pxyz = at.polynomial_of(shared, k)
            zc, size, own_red, own_green, own_blue, own_nx, own_ny, own_nz = at.look_of(shared, k)
            e0, e1, e2, tau, length = intersect_voxel(
                centre_x, centre_y, d0, d1, d2, ONE / d0, ONE / d1, ONE / d2, x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min
            )  # fmt: skip
            along = length * size
            total = sum_densities(e0, e1, e2, tau, length, d0, d1, d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
            thick = total * along * (ray_length * _THICK)
            w = -t * expm1(-thick)
            red += w * own_red
            green += w * own_green
            blue += w * own_blue
            depth += w * (zc + size * (tau + HALF * length))
            nx += w * own_nx
            ny += w * own_ny
            nz += w * own_nz
            squared += w * (own_red * own_red + own_green * own_green + own_blue * own_blue)
            away += w * max((own_nx * ray_x + own_ny * ray_y + own_nz) / ray_length, ZERO)
            if before < LOG2 and before + thick >= LOG2:
                slope = along / max(thick, TINY)
                median = zc + size * tau + slope * (LOG2 - before)
            before += thick
            t -= w
    if own:
        image[at.OUT_R, y, x], image[at.OUT_G, y, x], image[at.OUT_B, y, x], image[at.OUT_DEPTH, y, x] = red, green, blue, depth
        image[at.OUT_NX, y, x], image[at.OUT_NY, y, x], image[at.OUT_NZ, y, x], image[at.OUT_ALPHA, y, x] = nx, ny, nz, ONE - t
        image[at.OUT_MEDIAN, y, x], image[at.OUT_SLOPE, y, x] = median, slope
        image[at.OUT_SQUARE, y, x], image[at.OUT_AWAY, y, x] = squared, away


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
    centre_x, centre_y, thread = float32(x) + HALF, float32(y) + HALF, row * TILE_PX + column
    d0 = float32(ray_direction(camera, x + 0.5, y + 0.5, 0))
    d1 = float32(ray_direction(camera, x + 0.5, y + 0.5, 1))
    d2 = float32(ray_direction(camera, x + 0.5, y + 0.5, 2))
    ray_x, ray_y = float32((x + 0.5 - camera[14]) / camera[12]), float32((y + 0.5 - camera[15]) / camera[13])
    ray_length = float32(math.sqrt(d0 * d0 + d1 * d1 + d2 * d2))
    sums = cuda.shared.array((GRADIENT_WIDTH, THREADS), float32)
    parts = cuda.shared.array((GRADIENT_WIDTH, TILE_PX), float32)
    gr, gg, gb, gz = gradient[at.OUT_R, y, x], gradient[at.OUT_G, y, x], gradient[at.OUT_B, y, x], gradient[at.OUT_DEPTH, y, x]
    gnx, gny, gnz, g_alpha = gradient[at.OUT_NX, y, x], gradient[at.OUT_NY, y, x], gradient[at.OUT_NZ, y, x], gradient[at.OUT_ALPHA, y, x]
    g_median, g_square, g_away = gradient[at.OUT_MEDIAN, y, x], gradient[at.OUT_SQUARE, y, x], gradient[at.OUT_AWAY, y, x]
    by_thickness = g_median * image[at.OUT_SLOPE, y, x]
    total = ZERO
    for plane in range(GRAD_PLANES):
        if plane != at.OUT_MEDIAN:
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
            x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min = at.box_of(rows, voxel)
            p1, px, py, pz, pxy, pxz, pyz, pxyz = at.polynomial_of(rows, voxel)
            zc, size, red, green, blue, nx, ny, nz = at.look_of(rows, voxel)
            e0, e1, e2, tau, length = intersect_voxel(
                centre_x, centre_y, d0, d1, d2, ONE / d0, ONE / d1, ONE / d2, x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min
            )  # fmt: skip
            per_value = length * size * (ray_length * _THICK)
            thick = sum_densities(e0, e1, e2, tau, length, d0, d1, d2, p1, px, py, pz, pxy, pxz, pyz, pxyz) * per_value
            alpha = -expm1(-thick)
            w = t * alpha
            cosine = (nx * ray_x + ny * ray_y + nz) / ray_length
            value = gr * red + gg * green + gb * blue + gnx * nx + gny * ny + gnz * nz + g_alpha
            value += g_square * (red * red + green * green + blue * blue) + g_away * max(cosine, ZERO)
            value += gz * (zc + size * (tau + HALF * length))
            through += w * value
            by_thick = (t - w) * value - (total - through)
            # The depth at which half of the light is gone moves nearer with every thickness before it.
            if before < LOG2:
                by_thick -= by_thickness * (ONE if before + thick < LOG2 else (LOG2 - before) / max(thick, TINY))
            before += thick
            t -= w
            for k in range(SAMPLES):
                place = sample_at(tau, length, k)
                u0, u1, u2 = e0 + place * d0, e1 + place * d1, e2 + place * d2
                v = interpolate_density(u0, u1, u2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
                by_value = by_thick * per_value * activation_slope(v)
                sums[at.G_P, thread] += by_value
                sums[at.G_P + 1, thread] += by_value * u0
                sums[at.G_P + 2, thread] += by_value * u1
                sums[at.G_P + 3, thread] += by_value * u2
                sums[at.G_P + 4, thread] += by_value * (u0 * u1)
                sums[at.G_P + 5, thread] += by_value * (u0 * u2)
                sums[at.G_P + 6, thread] += by_value * (u1 * u2)
                sums[at.G_P + 7, thread] += by_value * (u0 * u1 * u2)
            sums[at.G_RED, thread] = w * (gr + TWO * g_square * red)
            sums[at.G_RED + 1, thread] = w * (gg + TWO * g_square * green)
            sums[at.G_RED + 2, thread] = w * (gb + TWO * g_square * blue)
            by_cosine = w * g_away / ray_length if cosine > ZERO else ZERO
            sums[at.G_NX, thread] = w * gnx + by_cosine * ray_x
            sums[at.G_NX + 1, thread] = w * gny + by_cosine * ray_y
            sums[at.G_NX + 2, thread] = w * gnz + by_cosine
            sums[at.G_WEIGHT, thread] = w
            # |alpha d loss / d alpha|, where d alpha = exp(-x) dx.
            sums[at.G_PRIORITY, thread] = abs(by_thick) * alpha / max(ONE - alpha, STOP)
        cuda.syncthreads()
        # A thread for each column of the voxel's row and row of pixels; then one for each column.
        parts[column, row] = fold_row(sums, column, row * TILE_PX, at.G_WEIGHT)
        cuda.syncthreads()
        if row == 0:
            slots[slot_of[entry], column] = fold_row(parts, column, 0, at.G_WEIGHT)
