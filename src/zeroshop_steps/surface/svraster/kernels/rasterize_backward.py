"""The backward CPU kernel of sparse voxels: carry gradients of the image back to the voxels' rows.

It goes front to back too. With u_i the derivative of the loss by the blending weight w_i = T_i (1 - exp(-x_i)), x_i the
optical thickness,

    d loss / d x_i = T_i exp(-x_i) u_i - sum_{j > i} w_j u_j,

and the sum over the voxels behind is the total, known from the forward pass, less the running sum.
Gradients go to one row for each (pair, voxel) pair, which are then summed in fixed order: same bytes every run.
"""

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tile_sums import take_sums
from zeroshop_steps.surface.rendering.tiling import ACROSS, BIT, BLOCK_PX, BLOCKS, HALF, LANES, ONE, PLANE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.svraster.kernels import layout as at
from zeroshop_steps.surface.svraster.kernels.intersection import (
    SAMPLES,
    activation_slope,
    expm1,
    interpolate_density,
    intersect_voxel,
    sample_at,
    sum_densities,
)
from zeroshop_steps.surface.svraster.kernels.layout import GRAD_PLANES, GRADIENT_WIDTH
from zeroshop_steps.surface.svraster.kernels.rasterize import LOG2, TINY, load_pixels, world_normal

# Planes of a block's buffer after the ones that `load_pixels` fills: running sum, its total, the median's slope, gradients.
_SUM, _TOTAL, _SLOPE, _G = range(at.OWN, at.OWN + 4)
_PLANES = _G + GRAD_PLANES
# Sums over a tile's pixels: the columns of the gradient, then the normal's by the cosine, and the square of the colour's.
_AWAY, _SQUARE, _SUMS = GRADIENT_WIDTH, GRADIENT_WIDTH + 3, GRADIENT_WIDTH + 4


@numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
def _differentiate_voxel(rows, index, n0, n1, n2, b, sums, blocks, totals):
    """Gradients of one voxel over some blocks (one bit a block) of an pair, into totals (20,); sums (20 * 16,) holds zeros.

    n0, n1, n2: its normal in the world.
    """
    x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min = at.box_of(rows, index)
    p1, px, py, pz, pxy, pxz, pyz, pxyz = at.polynomial_of(rows, index)
    zc, size, red, green, blue, nx, ny, nz = at.look_of(rows, index)
    square = red * red + green * green + blue * blue
    while blocks:
        rest = blocks & (blocks - np.uint64(1))
        first = BIT[(blocks ^ rest) % np.uint64(19)] * np.uint64(_PLANES * LANES)
        blocks = rest
        for lane in range(np.uint64(LANES)):
            i = first + lane
            d0, d1, d2 = b[i + PLANE[at.D]], b[i + PLANE[at.D + 1]], b[i + PLANE[at.D + 2]]
            e0, e1, e2, tau, length = intersect_voxel(
                b[i], b[i + PLANE[at.Y]], d0, d1, d2, b[i + PLANE[at.R]], b[i + PLANE[at.R + 1]], b[i + PLANE[at.R + 2]],
                x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min,
            )  # fmt: skip
            total = sum_densities(e0, e1, e2, tau, length, d0, d1, d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
            t = b[i + PLANE[at.T]]
            along = length * size
            thick = along * b[i + PLANE[at.THICK]]
            thick = thick if t >= STOP else ZERO
            x = total * thick
            alpha = -expm1(-x)
            w = t * alpha
            z = zc + size * (tau + HALF * length)
            gr, gg, gb = b[i + PLANE[_G]], b[i + PLANE[_G + 1]], b[i + PLANE[_G + 2]]
            gnx, gny, gnz = b[i + PLANE[_G + 4]], b[i + PLANE[_G + 5]], b[i + PLANE[_G + 6]]
            g_two, g_away = b[i + PLANE[_G + at.OUT_SQUARE]], b[i + PLANE[_G + at.OUT_AWAY]]
            cosine = (n0 * d0 + n1 * d1 + n2 * d2) * b[i + PLANE[at.LENGTH]]
            value = gr * red + gg * green + gb * blue + gnx * nx + gny * ny + gnz * nz + b[i + PLANE[_G + at.OUT_ALPHA]]
            value += b[i + PLANE[_G + at.OUT_DEPTH]] * z + g_two * square + g_away * max(cosine, ZERO)
            through = b[i + PLANE[_SUM]] + w * value
            b[i + PLANE[_SUM]] = through
            d_x = (t - w) * value - (b[i + PLANE[_TOTAL]] - through)
            before = b[i + PLANE[at.SUM_X]]
            after = before + x
            b[i + PLANE[at.SUM_X]] = after
            b[i + PLANE[at.T]] = t - w
            # The depth at which half of the light is gone moves nearer with every thickness before it.
            share = ONE if after < LOG2 else (LOG2 - before) / max(x, TINY)
            share = share if before < LOG2 else ZERO
            d_x -= b[i + PLANE[_G + at.OUT_MEDIAN]] * b[i + PLANE[_SLOPE]] * share
            d_each = d_x * thick
            for k in range(SAMPLES):
                place = sample_at(tau, length, k)
                u0, u1, u2 = e0 + place * d0, e1 + place * d1, e2 + place * d2
                v = interpolate_density(u0, u1, u2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
                d_v = d_each * activation_slope(v)
                sums[lane + PLANE[at.G_P]] += d_v
                sums[lane + PLANE[at.G_P + 1]] += d_v * u0
                sums[lane + PLANE[at.G_P + 2]] += d_v * u1
                sums[lane + PLANE[at.G_P + 3]] += d_v * u2
                sums[lane + PLANE[at.G_P + 4]] += d_v * (u0 * u1)
                sums[lane + PLANE[at.G_P + 5]] += d_v * (u0 * u2)
                sums[lane + PLANE[at.G_P + 6]] += d_v * (u1 * u2)
                sums[lane + PLANE[at.G_P + 7]] += d_v * (u0 * u1 * u2)
            sums[lane + PLANE[at.G_RED]] += w * gr
            sums[lane + PLANE[at.G_RED + 1]] += w * gg
            sums[lane + PLANE[at.G_RED + 2]] += w * gb
            sums[lane + PLANE[_SQUARE]] += w * g_two
            sums[lane + PLANE[at.G_NX]] += w * gnx
            sums[lane + PLANE[at.G_NX + 1]] += w * gny
            sums[lane + PLANE[at.G_NX + 2]] += w * gnz
            d_cosine = w * g_away * b[i + PLANE[at.LENGTH]] if cosine > ZERO else ZERO
            sums[lane + PLANE[_AWAY]] += d_cosine * d0
            sums[lane + PLANE[_AWAY + 1]] += d_cosine * d1
            sums[lane + PLANE[_AWAY + 2]] += d_cosine * d2
            sums[lane + PLANE[at.G_WEIGHT]] = max(sums[lane + PLANE[at.G_WEIGHT]], w)
            # |alpha d loss / d alpha|, where d alpha = exp(-x) dx.
            sums[lane + PLANE[at.G_PRIORITY]] += abs(d_x) * alpha / max(ONE - alpha, STOP)
    take_sums(sums, at.G_WEIGHT, totals)
    by_square = TWO * totals[_SQUARE]
    totals[at.G_RED] += by_square * red
    totals[at.G_RED + 1] += by_square * green
    totals[at.G_RED + 2] += by_square * blue


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_backward(
    rows, camera, pair_tiles, pair_octants, pairs, starts, voxel_of, slot_of, slot_starts, tiles_x, workers, image, blocks, gradient, out,
    seen,
):  # fmt: skip
    """Gradients of the loss by the voxel rows.

    Args:
        image: (12, height, width), and blocks, as `blend_forward` left them.
        gradient: (11, height, width) float32, the loss's derivative by the first eleven planes.
        out: (N, 16) float32, overwritten; its last two columns are the largest blending weight and the priority.
        seen: (N,) bool, overwritten: the voxels that light reaches.
    """
    slots = np.empty((len(voxel_of), GRADIENT_WIDTH), np.float32)
    for worker in numba.prange(workers):
        b, sums, totals = np.empty(_PLANES * LANES * BLOCKS, np.float32), np.zeros(_SUMS * LANES, np.float32), np.empty(_SUMS, np.float32)
        for position in range(worker, len(pairs), workers):
            pair = pairs[position]
            tile_x, tile_y = pair_tiles[pair] % tiles_x, pair_tiles[pair] // tiles_x
            load_pixels(b, _PLANES, tile_x, tile_y, camera, pair_octants[pair])
            for block in range(BLOCKS):
                for lane in range(LANES):
                    y = tile_y * TILE_PX + block // ACROSS * BLOCK_PX + lane // BLOCK_PX
                    x = tile_x * TILE_PX + block % ACROSS * BLOCK_PX + lane % BLOCK_PX
                    i = block * _PLANES * LANES + lane
                    total = ZERO
                    for plane in range(GRAD_PLANES):
                        b[i + (_G + plane) * LANES] = gradient[plane, y, x]
                        if plane != at.OUT_MEDIAN:
                            total += gradient[plane, y, x] * image[plane, y, x]
                    b[i + _SUM * LANES] = ZERO
                    b[i + _TOTAL * LANES] = total
                    b[i + _SLOPE * LANES] = image[at.OUT_SLOPE, y, x]
            for entry in range(starts[pair], starts[pair + 1]):
                i, slot = voxel_of[entry], slot_of[entry]
                met = np.uint64(blocks[slot])
                if met:
                    n0, n1, n2 = world_normal(rows, i, camera, 0), world_normal(rows, i, camera, 1), world_normal(rows, i, camera, 2)
                    _differentiate_voxel(rows, i, n0, n1, n2, b, sums, met, totals)
                    a0, a1, a2 = totals[_AWAY], totals[_AWAY + 1], totals[_AWAY + 2]
                    for r in range(3):
                        totals[at.G_NX + r] += camera[3 * r] * a0 + camera[3 * r + 1] * a1 + camera[3 * r + 2] * a2
                    for column in range(GRADIENT_WIDTH):
                        slots[slot, column] = totals[column]
    for i in numba.prange(len(rows)):
        seen[i] = False
        for column in range(GRADIENT_WIDTH):
            out[i, column] = ZERO
        for slot in range(slot_starts[i], slot_starts[i + 1]):
            if blocks[slot]:
                seen[i] = True
                largest = max(out[i, at.G_WEIGHT], slots[slot, at.G_WEIGHT])
                for column in range(GRADIENT_WIDTH):
                    out[i, column] += slots[slot, column]
                out[i, at.G_WEIGHT] = largest
