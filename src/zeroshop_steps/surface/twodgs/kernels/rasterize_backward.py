"""The backward CPU kernel of 2D Gaussian Splatting: carry gradients of the image back to the splats.

It goes front to back too. With v_i the derivative of the loss by the blending weight w_i = T_i alpha_i,

    d loss / d alpha_i = T_i v_i - (sum_{j > i} w_j v_j) / (1 - alpha_i),

and the sum over the splats behind is the total, known from the forward pass, less the running sum.
Gradients go to one row for each (tile, splat) pair, which are then summed in fixed order: same bytes every run.
"""

from collections.abc import Callable

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tile_sums import NO_MAXIMUM, take_sums
from zeroshop_steps.surface.rendering.tiling import ACROSS, BIT, BLOCK_PX, BLOCKS, HALF, LANES, ONE, PLANE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.twodgs.kernels import layout as at
from zeroshop_steps.surface.twodgs.kernels.intersection import HALF_SQRT, intersect_surfel
from zeroshop_steps.surface.twodgs.kernels.layout import GRAD_PLANES, SPLAT_WIDTH
from zeroshop_steps.surface.twodgs.kernels.rasterize import ALPHA_MAX, CUT, load_pixels

# Planes of a block's buffer: x, y, transmittance, running sum, its total, the gradients, then the forward pass's totals.
_T, _SUM, _TOTAL, _G, _ALPHA, _MEDIAN, _M1, _M2 = 2, 3, 4, 5, 15, 16, 17, 18
_PLANES = 19


def _splat_kernel(distortion: bool) -> Callable:
    """The kernel of one splat, with or without a gradient of the distortion sum: decided when it is compiled."""

    @numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
    def differentiate_splat(splats, index, b, sums, blocks, k1, k2, out):
        """Gradients of splat `index` over some blocks (one bit a block) of a tile, into out (16,); sums (16 * 16,) holds zeros."""
        cx, cy, u1, u2, v1, v2, a1, a2 = at.shape_of(splats, index)
        zc, opacity, red, green, blue, nx, ny, nz = at.look_of(splats, index)
        inverse_zc = ONE / zc
        while blocks:
            rest = blocks & (blocks - np.uint64(1))
            first = BIT[(blocks ^ rest) % np.uint64(19)] * np.uint64(_PLANES * LANES)
            blocks = rest
            for lane in range(np.uint64(LANES)):
                i = first + lane
                dx = b[i] - cx
                dy = b[i + PLANE[1]] - cy
                on_surfel, a, r, u, v, at_surfel, e = intersect_surfel(dx, dy, u1, u2, v1, v2, a1, a2)
                z = zc * r
                full = opacity * e
                alpha = min(full, ALPHA_MAX)
                t = b[i + PLANE[_T]]
                visible = (alpha >= CUT) & (t >= STOP)
                w = t * alpha if visible else ZERO
                gr, gg, gb = b[i + PLANE[_G]], b[i + PLANE[_G + 1]], b[i + PLANE[_G + 2]]
                gz = b[i + PLANE[_G + 3]]
                gnx, gny, gnz = b[i + PLANE[_G + 4]], b[i + PLANE[_G + 5]], b[i + PLANE[_G + 6]]
                g_alpha, g_median = b[i + PLANE[_G + 7]], b[i + PLANE[_G + 8]]
                value = gr * red + gg * green + gb * blue + gz * z + gnx * nx + gny * ny + gnz * nz + g_alpha
                if distortion:
                    inverse_z = inverse_zc * a
                    m = k1 - k2 * inverse_z
                    g_distortion = b[i + PLANE[_G + at.OUT_DISTORTION]]
                    total_alpha, m1, m2 = b[i + PLANE[_ALPHA]], b[i + PLANE[_M1]], b[i + PLANE[_M2]]
                    value += g_distortion * (m * m * total_alpha + m2 - TWO * m * m1)
                behind = b[i + PLANE[_SUM]] + w * value
                b[i + PLANE[_SUM]] = behind
                b[i + PLANE[_T]] = t - w
                d_alpha = t * value - (b[i + PLANE[_TOTAL]] - behind) / (ONE - alpha)
                # Times alpha, which is opacity times the Gaussian: the derivative by the logarithm of either.
                d_log = alpha * d_alpha if visible & (full <= ALPHA_MAX) else ZERO
                is_median = visible & (t > HALF) & (z == b[i + PLANE[_MEDIAN]])
                d_z = w * gz + (g_median if is_median else ZERO)
                if distortion:
                    d_z += g_distortion * TWO * w * (m * total_alpha - m1) * k2 * inverse_z * inverse_z
                sums[lane + PLANE[at.OPACITY]] += d_log
                sums[lane + PLANE[at.RED]] += w * gr
                sums[lane + PLANE[at.GREEN]] += w * gg
                sums[lane + PLANE[at.BLUE]] += w * gb
                sums[lane + PLANE[at.NX]] += w * gnx
                sums[lane + PLANE[at.NY]] += w * gny
                sums[lane + PLANE[at.NZ]] += w * gnz
                d_zc = d_z * r
                sums[lane + PLANE[at.ZC]] += d_zc
                # Minus half the derivatives by the numerators of u and v, times sqrt(2), and by a, where the disk counts.
                d_surfel = d_log * r if on_surfel else ZERO
                d_u = d_surfel * u
                d_v = d_surfel * v
                d_a = (d_zc * HALF * z if on_surfel else ZERO) - d_surfel * at_surfel
                d_pixel = ZERO if on_surfel else d_log
                sums[lane + PLANE[at.U1]] += d_u * dx
                sums[lane + PLANE[at.U2]] += d_u * dy
                sums[lane + PLANE[at.V1]] += d_v * dx
                sums[lane + PLANE[at.V2]] += d_v * dy
                sums[lane + PLANE[at.A1]] += d_a * dx
                sums[lane + PLANE[at.A2]] += d_a * dy
                sums[lane + PLANE[at.CX]] += d_u * u1 + d_v * v1 + d_a * a1 + d_pixel * dx
                sums[lane + PLANE[at.CY]] += d_u * u2 + d_v * v2 + d_a * a2 + d_pixel * dy
        take_sums(sums, NO_MAXIMUM, out)
        for column in (at.CX, at.CY):
            out[column] *= TWO
        for column in (at.U1, at.U2, at.V1, at.V2):
            out[column] *= -TWO * HALF_SQRT
        for column in (at.A1, at.A2):
            out[column] *= -TWO
        out[at.OPACITY] /= opacity

    return differentiate_splat


_differentiate_splat, _differentiate_splat_with_distortion = _splat_kernel(False), _splat_kernel(True)


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_backward(
    splats, tiles, starts, splat_of, slot_of, slot_starts, blocks, tiles_x, distortion, k1, k2, workers, image, gradient, out
):
    """Gradients of the loss by the splat rows.

    Args:
        image: (12, height, width), and blocks, as `blend_forward` left them.
        distortion: whether the gradient by the distortion counts; otherwise it must be zero.
        gradient: (10, height, width) float32, the loss's derivative by the first ten planes.
        out: (N, 16) float32, overwritten.
    """
    slots = np.empty((len(blocks), SPLAT_WIDTH), np.float32)
    for worker in numba.prange(workers):
        b, sums = np.empty(_PLANES * LANES * BLOCKS, np.float32), np.zeros(SPLAT_WIDTH * LANES, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            load_pixels(b, _PLANES, tile_x, tile_y)
            for block in range(BLOCKS):
                y0, x0 = tile_y * TILE_PX + block // ACROSS * BLOCK_PX, tile_x * TILE_PX + block % ACROSS * BLOCK_PX
                for lane in range(LANES):
                    i = block * _PLANES * LANES + lane
                    y, x = y0 + lane // BLOCK_PX, x0 + lane % BLOCK_PX
                    b[i + _SUM * LANES] = 0.0
                    total = TWO * gradient[at.OUT_DISTORTION, y, x] * image[at.OUT_DISTORTION, y, x]
                    for plane in range(GRAD_PLANES):
                        b[i + (_G + plane) * LANES] = gradient[plane, y, x]
                        if plane < at.OUT_MEDIAN:
                            total += gradient[plane, y, x] * image[plane, y, x]
                    b[i + _TOTAL * LANES] = total
                    b[i + _ALPHA * LANES] = image[at.OUT_ALPHA, y, x]
                    b[i + _MEDIAN * LANES] = image[at.OUT_MEDIAN, y, x]
                    b[i + _M1 * LANES] = image[at.OUT_M1, y, x]
                    b[i + _M2 * LANES] = image[at.OUT_M2, y, x]
            for entry in range(starts[tile], starts[tile + 1]):
                slot = slot_of[entry]
                met = np.uint64(blocks[slot])
                if met:
                    i = splat_of[entry]
                    if distortion:
                        _differentiate_splat_with_distortion(splats, i, b, sums, met, k1, k2, slots[slot])
                    else:
                        _differentiate_splat(splats, i, b, sums, met, k1, k2, slots[slot])
    for i in numba.prange(len(splats)):
        out[i] = ZERO
        for slot in range(slot_starts[i], slot_starts[i + 1]):
            if blocks[slot]:
                for column in range(SPLAT_WIDTH):
                    out[i, column] += slots[slot, column]
