"""The CPU kernels of 2D Gaussian Splatting: blend splats front to back, and carry gradients back to them.

Each tile of 16 x 16 pixels is drawn by one thread. A splat visits the blocks of 4 x 4 pixels that its footprint meets and
that light still reaches; the backward pass is told which. The loop over the pixels of a block becomes vector instructions;
the planes of a block lie one behind the other in one buffer, so that the compiler can prove loads and stores apart.

The backward pass goes front to back too. With v_i the derivative of the loss by the blending weight w_i = T_i alpha_i,

    d loss / d alpha_i = T_i v_i - (sum_{j > i} w_j v_j) / (1 - alpha_i),

and the sum over the splats behind is the total, known from the forward pass, less the running sum.
Gradients go to one row for each (tile, splat) pair, which are then summed in fixed order: same bytes every run.
"""

import numba
import numpy as np

from zeroshop_steps.nvs.twodgs.project import (
    A1,
    A2,
    ALPHA_MIN,
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
from zeroshop_steps.nvs.twodgs.tiles import ACROSS, BLOCK_PX
from zeroshop_steps.nvs.views import TILE_PX

LANES = BLOCK_PX * BLOCK_PX
"""Pixels of a block."""
BLOCKS = ACROSS * ACROSS

# Planes of the image that `blend_forward` fills: colour, depth, normal, opacity, median depth, and the distortion
# sum of eq. 13 with its first and second moments of the mapped depth.
(OUT_R, OUT_G, OUT_B, OUT_DEPTH, OUT_NX, OUT_NY, OUT_NZ, OUT_ALPHA, OUT_MEDIAN, OUT_DISTORTION, OUT_M1, OUT_M2) = range(12)
OUT_PLANES = 12
GRAD_PLANES = 10
"""Planes with a gradient: colour, depth, normal, opacity, median depth, distortion."""

# Where each plane of a block begins. Unsigned, since a signed index might be a negative one that counts from the
# end, and the compiler then gives up on vector instructions.
_PLANE = tuple(np.uint64(plane * LANES) for plane in range(20))
_LANES = np.uint64(LANES)
# The number of a bit, at the remainder of its value divided by 19: two is a primitive root of 19.
_BIT = np.array([0, 0, 1, 13, 2, 16, 14, 6, 3, 8, 17, 12, 15, 5, 7, 11, 4, 10, 9], np.int64)
_CUT = np.float32(ALPHA_MIN)
_STOP = np.float32(1e-4)
_ALPHA_MAX = np.float32(0.99)
_ONE, _HALF, _TWO, _ZERO = np.float32(1.0), np.float32(0.5), np.float32(2.0), np.float32(0.0)
_FAR = np.float32(1e30)
_A_MIN = np.float32(1e-6)
# exp(x) = (exp(x / 4 + ln 2) / 2)^4 with a Taylor polynomial of degree 8 whose argument stays within +-0.72.
_QUARTER, _LN2, _SIXTEENTH, _LOWEST = np.float32(0.25), np.float32(np.log(2.0)), np.float32(1 / 16), np.float32(-5.65)
_E2, _E3, _E4, _E5 = np.float32(1 / 2), np.float32(1 / 6), np.float32(1 / 24), np.float32(1 / 120)
_E6, _E7, _E8 = np.float32(1 / 720), np.float32(1 / 5040), np.float32(1 / 40320)


@numba.njit(inline="always", fastmath=True)
def _exp_small(x):
    """exp(x) for x in [-5.65, 0]; smaller x give exp(-5.65), which lies below every cut."""
    t = max(x, _LOWEST) * _QUARTER + _LN2
    y = _ONE + t * (_ONE + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    y = y * y
    return y * y * _SIXTEENTH


@numba.njit(inline="always", fastmath=True)
def _meet(dx, dy, zc, u1, u2, v1, v2, a1, a2):
    """Where the ray of a pixel, (dx, dy) from the projected centre, meets the disk, or its low-pass filter if that is nearer.

    Returns:
        r = 1 / a, u, v; whether the disk counts; depth and its inverse; and the Gaussian's value.
    """
    a = _ONE + a1 * dx + a2 * dy
    ahead = a > _A_MIN
    r = _ONE / (a if ahead else _ONE)
    u = (u1 * dx + u2 * dy) * r
    v = (v1 * dx + v2 * dy) * r
    rho_disk = u * u + v * v if ahead else _FAR
    rho_pixel = _TWO * (dx * dx + dy * dy)
    on_disk = rho_disk <= rho_pixel
    rho = rho_disk if on_disk else rho_pixel
    z = zc * r if on_disk else zc
    inverse_z = (a if on_disk else _ONE) / zc
    return r, u, v, on_disk, z, inverse_z, _exp_small(-_HALF * rho)


@numba.njit(cache=True)
def _load_pixels(b, planes, tile_x, tile_y):
    """Pixel positions into the first two planes of every block."""
    for block in range(BLOCKS):
        for lane in range(LANES):
            i = block * planes * LANES + lane
            b[i] = np.float32(tile_x * TILE_PX + block % ACROSS * BLOCK_PX + lane % BLOCK_PX) + _HALF
            b[i + LANES] = np.float32(tile_y * TILE_PX + block // ACROSS * BLOCK_PX + lane // BLOCK_PX) + _HALF


# Planes of a block in the forward pass: x, y, transmittance, then the outputs.
_T, _OUT = 2, 3
_FORWARD_PLANES = _OUT + OUT_PLANES


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _forward_splat(s, b, blocks, k1, k2):
    """Blend one splat into some blocks (one bit a block) of a tile's buffer; returns those that no light passes any more."""
    cx, cy, zc, u1, u2, v1, v2, a1, a2 = s[CX], s[CY], s[ZC], s[U1], s[U2], s[V1], s[V2], s[A1], s[A2]
    opacity, red, green, blue, nx, ny, nz = s[OPACITY], s[RED], s[GREEN], s[BLUE], s[NX], s[NY], s[NZ]
    dark = 0
    while blocks:
        bit = blocks & -blocks
        blocks ^= bit
        first = np.uint64(_BIT[bit % 19] * _FORWARD_PLANES * LANES)
        lit = _ZERO
        for i in range(first, first + _LANES):
            dx = b[i] - cx
            dy = b[i + _PLANE[1]] - cy
            r, u, v, on_disk, z, inverse_z, e = _meet(dx, dy, zc, u1, u2, v1, v2, a1, a2)
            alpha = min(opacity * e, _ALPHA_MAX)
            t = b[i + _PLANE[_T]]
            visible = (alpha >= _CUT) & (t >= _STOP)
            w = t * alpha if visible else _ZERO
            b[i + _PLANE[_T]] = t - w
            lit += _ONE if t - w >= _STOP else _ZERO
            b[i + _PLANE[_OUT + OUT_R]] += w * red
            b[i + _PLANE[_OUT + OUT_G]] += w * green
            b[i + _PLANE[_OUT + OUT_B]] += w * blue
            b[i + _PLANE[_OUT + OUT_DEPTH]] += w * z
            b[i + _PLANE[_OUT + OUT_NX]] += w * nx
            b[i + _PLANE[_OUT + OUT_NY]] += w * ny
            b[i + _PLANE[_OUT + OUT_NZ]] += w * nz
            b[i + _PLANE[_OUT + OUT_MEDIAN]] = z if visible & (t > _HALF) else b[i + _PLANE[_OUT + OUT_MEDIAN]]
            m = k1 - k2 * inverse_z
            m1, m2 = b[i + _PLANE[_OUT + OUT_M1]], b[i + _PLANE[_OUT + OUT_M2]]
            b[i + _PLANE[_OUT + OUT_DISTORTION]] += w * (m * m * (_ONE - t) + m2 - _TWO * m * m1)
            b[i + _PLANE[_OUT + OUT_M1]] = m1 + w * m
            b[i + _PLANE[_OUT + OUT_M2]] = m2 + w * m * m
        dark |= 0 if lit > _ZERO else bit
    return dark


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_forward(splats, tiles, starts, splat_of, slot_of, blocks, tiles_x, k1, k2, workers, image):
    """Draw the tiles of `list_tiles` into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros.

    k1, k2: the mapped depth of the distortion term is k1 - k2 / z.
    blocks: those of `list_tiles`; ones that no light reaches are cleared, for the backward pass.
    """
    for worker in numba.prange(workers):
        b = np.empty(_FORWARD_PLANES * LANES * BLOCKS, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            b[:] = 0.0
            _load_pixels(b, _FORWARD_PLANES, tile_x, tile_y)
            for block in range(BLOCKS):
                start = (block * _FORWARD_PLANES + _T) * LANES
                b[start : start + LANES] = 1.0
            living = (1 << BLOCKS) - 1
            for entry in range(starts[tile], starts[tile + 1]):
                slot = slot_of[entry]
                met = np.int64(blocks[slot]) & living
                blocks[slot] = met
                if met:
                    living &= ~_forward_splat(splats[splat_of[entry]], b, met, k1, k2)
            for block in range(BLOCKS):
                y0, x0 = tile_y * TILE_PX + block // ACROSS * BLOCK_PX, tile_x * TILE_PX + block % ACROSS * BLOCK_PX
                start = block * _FORWARD_PLANES * LANES
                for lane in range(LANES):
                    b[start + (_OUT + OUT_ALPHA) * LANES + lane] = _ONE - b[start + _T * LANES + lane]
                for plane in range(OUT_PLANES):
                    for lane in range(LANES):
                        image[plane, y0 + lane // BLOCK_PX, x0 + lane % BLOCK_PX] = b[start + (_OUT + plane) * LANES + lane]


# Planes of a block in the backward pass: x, y, transmittance, running sum, its total, the gradients, then the forward pass's totals.
_SUM, _TOTAL, _G, _ALPHA, _MEDIAN, _M1, _M2 = 3, 4, 5, 15, 16, 17, 18
_BACKWARD_PLANES = 19


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _backward_splat(s, b, sums, blocks, k1, k2, out):
    """Gradients of one splat over some blocks (one bit a block) of a tile, into out (16,); sums (16 * 16,) is scratch."""
    cx, cy, zc, u1, u2, v1, v2, a1, a2 = s[CX], s[CY], s[ZC], s[U1], s[U2], s[V1], s[V2], s[A1], s[A2]
    opacity, red, green, blue, nx, ny, nz = s[OPACITY], s[RED], s[GREEN], s[BLUE], s[NX], s[NY], s[NZ]
    sums[:] = _ZERO
    while blocks:
        bit = blocks & -blocks
        blocks ^= bit
        first = np.uint64(_BIT[bit % 19] * _BACKWARD_PLANES * LANES)
        for lane in range(_LANES):
            i = first + lane
            dx = b[i] - cx
            dy = b[i + _PLANE[1]] - cy
            r, u, v, on_disk, z, inverse_z, e = _meet(dx, dy, zc, u1, u2, v1, v2, a1, a2)
            full = opacity * e
            alpha = min(full, _ALPHA_MAX)
            t = b[i + _PLANE[_T]]
            visible = (alpha >= _CUT) & (t >= _STOP)
            w = t * alpha if visible else _ZERO
            gr, gg, gb = b[i + _PLANE[_G]], b[i + _PLANE[_G + 1]], b[i + _PLANE[_G + 2]]
            gz = b[i + _PLANE[_G + 3]]
            gnx, gny, gnz = b[i + _PLANE[_G + 4]], b[i + _PLANE[_G + 5]], b[i + _PLANE[_G + 6]]
            g_alpha, g_median, g_distortion = b[i + _PLANE[_G + 7]], b[i + _PLANE[_G + 8]], b[i + _PLANE[_G + 9]]
            m = k1 - k2 * inverse_z
            total_alpha, m1, m2 = b[i + _PLANE[_ALPHA]], b[i + _PLANE[_M1]], b[i + _PLANE[_M2]]
            value = gr * red + gg * green + gb * blue + gz * z + gnx * nx + gny * ny + gnz * nz + g_alpha
            value += g_distortion * (m * m * total_alpha + m2 - _TWO * m * m1)
            behind = b[i + _PLANE[_SUM]] + w * value
            d_alpha = t * value - (b[i + _PLANE[_TOTAL]] - behind) / (_ONE - alpha)
            d_alpha = d_alpha if visible & (full <= _ALPHA_MAX) else _ZERO
            b[i + _PLANE[_SUM]] = behind
            b[i + _PLANE[_T]] = t - w
            is_median = visible & (t > _HALF) & (z == b[i + _PLANE[_MEDIAN]])
            d_z = w * gz + (g_median if is_median else _ZERO)
            d_z += g_distortion * _TWO * w * (m * total_alpha - m1) * k2 * inverse_z * inverse_z
            d_rho = -_HALF * alpha * d_alpha
            sums[lane + _PLANE[OPACITY]] += d_alpha * e
            sums[lane + _PLANE[RED]] += w * gr
            sums[lane + _PLANE[GREEN]] += w * gg
            sums[lane + _PLANE[BLUE]] += w * gb
            sums[lane + _PLANE[NX]] += w * gnx
            sums[lane + _PLANE[NY]] += w * gny
            sums[lane + _PLANE[NZ]] += w * gnz
            d_disk = d_rho if on_disk else _ZERO
            d_pixel = _ZERO if on_disk else d_rho
            dz_disk = d_z if on_disk else _ZERO
            sums[lane + _PLANE[ZC]] += dz_disk * r + (_ZERO if on_disk else d_z)
            d_u = _TWO * u * d_disk * r
            d_v = _TWO * v * d_disk * r
            d_a = -(d_u * u + d_v * v + dz_disk * zc * r * r)
            sums[lane + _PLANE[U1]] += d_u * dx
            sums[lane + _PLANE[U2]] += d_u * dy
            sums[lane + _PLANE[V1]] += d_v * dx
            sums[lane + _PLANE[V2]] += d_v * dy
            sums[lane + _PLANE[A1]] += d_a * dx
            sums[lane + _PLANE[A2]] += d_a * dy
            sums[lane + _PLANE[CX]] -= d_u * u1 + d_v * v1 + d_a * a1 + np.float32(4.0) * dx * d_pixel
            sums[lane + _PLANE[CY]] -= d_u * u2 + d_v * v2 + d_a * a2 + np.float32(4.0) * dy * d_pixel
    # One loop for all columns: the compiler sums sixteen registers across at once.
    g_cx = g_cy = g_zc = g_u1 = g_u2 = g_v1 = g_v2 = g_a1 = g_a2 = g_op = _ZERO
    g_red = g_green = g_blue = g_nx = g_ny = g_nz = _ZERO
    for lane in range(_LANES):
        g_cx += sums[lane + _PLANE[CX]]
        g_cy += sums[lane + _PLANE[CY]]
        g_zc += sums[lane + _PLANE[ZC]]
        g_u1 += sums[lane + _PLANE[U1]]
        g_u2 += sums[lane + _PLANE[U2]]
        g_v1 += sums[lane + _PLANE[V1]]
        g_v2 += sums[lane + _PLANE[V2]]
        g_a1 += sums[lane + _PLANE[A1]]
        g_a2 += sums[lane + _PLANE[A2]]
        g_op += sums[lane + _PLANE[OPACITY]]
        g_red += sums[lane + _PLANE[RED]]
        g_green += sums[lane + _PLANE[GREEN]]
        g_blue += sums[lane + _PLANE[BLUE]]
        g_nx += sums[lane + _PLANE[NX]]
        g_ny += sums[lane + _PLANE[NY]]
        g_nz += sums[lane + _PLANE[NZ]]
    out[CX], out[CY], out[ZC], out[U1], out[U2], out[V1], out[V2], out[A1], out[A2] = g_cx, g_cy, g_zc, g_u1, g_u2, g_v1, g_v2, g_a1, g_a2
    out[OPACITY], out[RED], out[GREEN], out[BLUE], out[NX], out[NY], out[NZ] = g_op, g_red, g_green, g_blue, g_nx, g_ny, g_nz


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_backward(splats, tiles, starts, splat_of, slot_of, slot_starts, blocks, tiles_x, k1, k2, workers, image, gradient, out):
    """Gradients of the loss by the splat rows.

    Args:
        image: (12, height, width), and blocks, as `blend_forward` left them.
        gradient: (10, height, width) float32, the loss's derivative by the first ten planes.
        out: (N, 16) float32, overwritten.
    """
    slots = np.empty((len(blocks), SPLAT_WIDTH), np.float32)
    for worker in numba.prange(workers):
        b, sums = np.empty(_BACKWARD_PLANES * LANES * BLOCKS, np.float32), np.empty(SPLAT_WIDTH * LANES, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            _load_pixels(b, _BACKWARD_PLANES, tile_x, tile_y)
            for block in range(BLOCKS):
                y0, x0 = tile_y * TILE_PX + block // ACROSS * BLOCK_PX, tile_x * TILE_PX + block % ACROSS * BLOCK_PX
                for lane in range(LANES):
                    i = block * _BACKWARD_PLANES * LANES + lane
                    y, x = y0 + lane // BLOCK_PX, x0 + lane % BLOCK_PX
                    b[i + _T * LANES] = 1.0
                    b[i + _SUM * LANES] = 0.0
                    total = _TWO * gradient[OUT_DISTORTION, y, x] * image[OUT_DISTORTION, y, x]
                    for plane in range(GRAD_PLANES):
                        b[i + (_G + plane) * LANES] = gradient[plane, y, x]
                        if plane < OUT_MEDIAN:
                            total += gradient[plane, y, x] * image[plane, y, x]
                    b[i + _TOTAL * LANES] = total
                    b[i + _ALPHA * LANES] = image[OUT_ALPHA, y, x]
                    b[i + _MEDIAN * LANES] = image[OUT_MEDIAN, y, x]
                    b[i + _M1 * LANES] = image[OUT_M1, y, x]
                    b[i + _M2 * LANES] = image[OUT_M2, y, x]
            for entry in range(starts[tile], starts[tile + 1]):
                slot = slot_of[entry]
                if blocks[slot]:
                    _backward_splat(splats[splat_of[entry]], b, sums, np.int64(blocks[slot]), k1, k2, slots[slot])
    for i in numba.prange(len(splats)):
        out[i] = _ZERO
        for slot in range(slot_starts[i], slot_starts[i + 1]):
            if blocks[slot]:
                for column in range(SPLAT_WIDTH):
                    out[i, column] += slots[slot, column]
