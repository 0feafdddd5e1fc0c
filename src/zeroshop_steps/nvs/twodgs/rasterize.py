"""The CPU kernels of 2D Gaussian Splatting: blend splats front to back, and carry gradients back to them.

Each tile of 16 x 16 pixels is drawn by one thread. Inside, a splat visits the rows of the tile that its box meets, as
one loop over consecutive pixels that the compiler turns into vector instructions; all state of a tile lies in one
flat buffer with planes at constant distance, so that it can prove the loads and stores apart.

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
from zeroshop_steps.nvs.twodgs.tiles import TILE_PX

AREA = TILE_PX * TILE_PX

# Planes of the image that `blend_forward` fills: colour, depth, normal, opacity, median depth, and the distortion
# sum of eq. 13 with its first and second moments of the mapped depth.
(OUT_R, OUT_G, OUT_B, OUT_DEPTH, OUT_NX, OUT_NY, OUT_NZ, OUT_ALPHA, OUT_MEDIAN, OUT_DISTORTION, OUT_M1, OUT_M2) = range(12)
OUT_PLANES = 12
GRAD_PLANES = 10
"""Planes with a gradient: colour, depth, normal, opacity, median depth, distortion."""

# Where each plane of a tile's buffer begins. Unsigned, since a signed index might be a negative one that counts from the
# end, and the compiler then gives up on vector instructions.
_PLANE = tuple(np.uint64(plane * AREA) for plane in range(20))
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


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _load_pixels(buffer, tile_x, tile_y):
    for i in range(AREA):
        buffer[i] = np.float32(tile_x * TILE_PX + i % TILE_PX) + _HALF
        buffer[AREA + i] = np.float32(tile_y * TILE_PX + i // TILE_PX) + _HALF


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _forward_splat(s, b, first, last, k1, k2):
    """Blend one splat into pixels first..last of the tile buffer; planes: x, y, T, then the outputs."""
    cx, cy, zc, u1, u2, v1, v2, a1, a2 = s[CX], s[CY], s[ZC], s[U1], s[U2], s[V1], s[V2], s[A1], s[A2]
    opacity, red, green, blue, nx, ny, nz = s[OPACITY], s[RED], s[GREEN], s[BLUE], s[NX], s[NY], s[NZ]
    for i in range(np.uint64(first), np.uint64(last)):
        dx = b[i] - cx
        dy = b[i + _PLANE[1]] - cy
        r, u, v, on_disk, z, inverse_z, e = _meet(dx, dy, zc, u1, u2, v1, v2, a1, a2)
        alpha = min(opacity * e, _ALPHA_MAX)
        t = b[i + _PLANE[2]]
        visible = (alpha >= _CUT) & (t >= _STOP)
        w = t * alpha if visible else _ZERO
        b[i + _PLANE[2]] = t - w
        b[i + _PLANE[3 + OUT_R]] += w * red
        b[i + _PLANE[3 + OUT_G]] += w * green
        b[i + _PLANE[3 + OUT_B]] += w * blue
        b[i + _PLANE[3 + OUT_DEPTH]] += w * z
        b[i + _PLANE[3 + OUT_NX]] += w * nx
        b[i + _PLANE[3 + OUT_NY]] += w * ny
        b[i + _PLANE[3 + OUT_NZ]] += w * nz
        b[i + _PLANE[3 + OUT_MEDIAN]] = z if visible & (t > _HALF) else b[i + _PLANE[3 + OUT_MEDIAN]]
        m = k1 - k2 * inverse_z
        m1, m2 = b[i + _PLANE[3 + OUT_M1]], b[i + _PLANE[3 + OUT_M2]]
        b[i + _PLANE[3 + OUT_DISTORTION]] += w * (m * m * (_ONE - t) + m2 - _TWO * m * m1)
        b[i + _PLANE[3 + OUT_M1]] = m1 + w * m
        b[i + _PLANE[3 + OUT_M2]] = m2 + w * m * m


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _alive(b, plane):
    most = _ZERO
    for i in range(AREA):
        most = max(most, b[plane * AREA + i])
    return most >= _STOP


@numba.njit(cache=True)
def _rows(box, tile_y):
    """First and last pixel, in the tile, of the rows that the box meets."""
    top = max(box[2] - tile_y * TILE_PX, 0)
    bottom = min(box[3] - tile_y * TILE_PX, TILE_PX)
    return top * TILE_PX, bottom * TILE_PX


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_forward(splats, boxes, tiles, starts, splat_of, tiles_x, k1, k2, workers, image):
    """Draw the tiles of `list_tiles` into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros.

    k1, k2: the mapped depth of the distortion term is k1 - k2 / z.
    """
    for worker in numba.prange(workers):
        b = np.empty((3 + OUT_PLANES) * AREA, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            b[:] = 0.0
            _load_pixels(b, tile_x, tile_y)
            b[2 * AREA : 3 * AREA] = 1.0
            for entry in range(starts[tile], starts[tile + 1]):
                if (entry - starts[tile]) % 8 == 7 and not _alive(b, 2):
                    break
                i = splat_of[entry]
                first, last = _rows(boxes[i], tile_y)
                _forward_splat(splats[i], b, first, last, k1, k2)
            for i in range(AREA):
                b[(3 + OUT_ALPHA) * AREA + i] = _ONE - b[2 * AREA + i]
            for plane in range(OUT_PLANES):
                for row in range(TILE_PX):
                    source = (3 + plane) * AREA + row * TILE_PX
                    image[plane, tile_y * TILE_PX + row, tile_x * TILE_PX : (tile_x + 1) * TILE_PX] = b[source : source + TILE_PX]


# Planes of the backward tile buffer, after x and y: transmittance, running sum, its total, then the gradient planes and the totals.
_T, _SUM, _TOTAL, _G, _ALPHA, _MEDIAN, _M1, _M2 = 2, 3, 4, 5, 15, 16, 17, 18
_BACKWARD_PLANES = 19


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _backward_splat(s, b, first, last, k1, k2, out):
    """Gradients of one splat over pixels first..last of a tile, into out (16,)."""
    cx, cy, zc, u1, u2, v1, v2, a1, a2 = s[CX], s[CY], s[ZC], s[U1], s[U2], s[V1], s[V2], s[A1], s[A2]
    opacity, red, green, blue, nx, ny, nz = s[OPACITY], s[RED], s[GREEN], s[BLUE], s[NX], s[NY], s[NZ]
    g_cx = g_cy = g_zc = g_u1 = g_u2 = g_v1 = g_v2 = g_a1 = g_a2 = g_op = _ZERO
    g_red = g_green = g_blue = g_nx = g_ny = g_nz = _ZERO
    for i in range(np.uint64(first), np.uint64(last)):
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
        g_op += d_alpha * e
        g_red += w * gr
        g_green += w * gg
        g_blue += w * gb
        g_nx += w * gnx
        g_ny += w * gny
        g_nz += w * gnz
        d_disk = d_rho if on_disk else _ZERO
        d_pixel = _ZERO if on_disk else d_rho
        dz_disk = d_z if on_disk else _ZERO
        g_zc += dz_disk * r + (_ZERO if on_disk else d_z)
        d_u = _TWO * u * d_disk * r
        d_v = _TWO * v * d_disk * r
        d_a = -(d_u * u + d_v * v + dz_disk * zc * r * r)
        g_u1 += d_u * dx
        g_u2 += d_u * dy
        g_v1 += d_v * dx
        g_v2 += d_v * dy
        g_a1 += d_a * dx
        g_a2 += d_a * dy
        g_cx -= d_u * u1 + d_v * v1 + d_a * a1 + np.float32(4.0) * dx * d_pixel
        g_cy -= d_u * u2 + d_v * v2 + d_a * a2 + np.float32(4.0) * dy * d_pixel
    out[CX], out[CY], out[ZC], out[U1], out[U2], out[V1], out[V2], out[A1], out[A2] = g_cx, g_cy, g_zc, g_u1, g_u2, g_v1, g_v2, g_a1, g_a2
    out[OPACITY], out[RED], out[GREEN], out[BLUE], out[NX], out[NY], out[NZ] = g_op, g_red, g_green, g_blue, g_nx, g_ny, g_nz


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_backward(splats, boxes, tiles, starts, splat_of, slot_of, slot_starts, tiles_x, k1, k2, workers, image, gradient, out):
    """Gradients of the loss by the splat rows.

    Args:
        image: (12, height, width) as `blend_forward` left it.
        gradient: (10, height, width) float32, the loss's derivative by the first ten planes.
        out: (N, 16) float32, overwritten.
    """
    slots = np.zeros((len(splat_of), SPLAT_WIDTH), np.float32)
    for worker in numba.prange(workers):
        b = np.empty(_BACKWARD_PLANES * AREA, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            _load_pixels(b, tile_x, tile_y)
            b[_T * AREA : (_T + 1) * AREA] = 1.0
            b[_SUM * AREA : (_TOTAL + 1) * AREA] = 0.0
            for row in range(TILE_PX):
                y, x0 = tile_y * TILE_PX + row, tile_x * TILE_PX
                for x in range(TILE_PX):
                    i = row * TILE_PX + x
                    for plane in range(GRAD_PLANES):
                        b[(_G + plane) * AREA + i] = gradient[plane, y, x0 + x]
                    total = _TWO * gradient[OUT_DISTORTION, y, x0 + x] * image[OUT_DISTORTION, y, x0 + x]
                    for plane in range(OUT_MEDIAN):
                        total += gradient[plane, y, x0 + x] * image[plane, y, x0 + x]
                    b[_TOTAL * AREA + i] = total
                    b[_ALPHA * AREA + i] = image[OUT_ALPHA, y, x0 + x]
                    b[_MEDIAN * AREA + i] = image[OUT_MEDIAN, y, x0 + x]
                    b[_M1 * AREA + i] = image[OUT_M1, y, x0 + x]
                    b[_M2 * AREA + i] = image[OUT_M2, y, x0 + x]
            for entry in range(starts[tile], starts[tile + 1]):
                if (entry - starts[tile]) % 8 == 7 and not _alive(b, _T):
                    break
                i = splat_of[entry]
                first, last = _rows(boxes[i], tile_y)
                _backward_splat(splats[i], b, first, last, k1, k2, slots[slot_of[entry]])
    for i in numba.prange(len(splats)):
        for column in range(SPLAT_WIDTH):
            total = _ZERO
            for slot in range(slot_starts[i], slot_starts[i + 1]):
                total += slots[slot, column]
            out[i, column] = total
