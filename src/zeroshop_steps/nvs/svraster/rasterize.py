"""The CPU kernels of sparse voxels: blend voxels front to back, and carry gradients back to them (Sun et al. 2025, sec. 3.1).

Each item, a tile of 16 x 16 pixels and an octant of ray directions, is drawn by one thread. Inside, a voxel visits the
rows of the tile that its box meets, as one loop over consecutive pixels that the compiler turns into vector instructions.

A ray meets a voxel in a segment of length l; its optical thickness is x = l / K * sum_k sigma(v_k) over K samples of the
interpolated value v, sigma the exponential-linear activation, and its opacity 1 - exp(-x). Front to back, with u_i the
derivative of the loss by the blending weight w_i = T_i (1 - exp(-x_i)),

    d loss / d x_i = T_i exp(-x_i) u_i - sum_{j > i} w_j u_j,

and the sum over the voxels behind is the total, known from the forward pass, less the running sum.
Gradients go to one row for each (item, voxel) pair, which are then summed in fixed order: same bytes every run.
"""

import numba
import numpy as np

from zeroshop_steps.nvs.svraster.project import (
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
    SIZE,
    TAU_MIN,
    X0,
    Y0,
    ZC,
)  # fmt: skip
from zeroshop_steps.nvs.svraster.tiles import octant_of, ray_direction
from zeroshop_steps.nvs.views import TILE_PX

AREA = TILE_PX * TILE_PX
SAMPLES = 2
"""Samples K of the density on each segment."""
DENSITY_SCALE = 100.0
"""Optical thickness, for each normalized unit of length, of an activated value of one."""
LINEAR_FROM = 1.1
"""Value from which the activation is linear (Sun et al. 2025, eq. 3)."""
STOP = 1e-4
"""Transmittance below which a pixel is finished."""

# Planes of the image that `blend_forward` fills: colour, depth, normal, opacity, median depth, weighted square of the
# colour, weighted cosine of normals that face away, and, by-product, the median depth's change with optical thickness.
(OUT_R, OUT_G, OUT_B, OUT_DEPTH, OUT_NX, OUT_NY, OUT_NZ, OUT_ALPHA, OUT_MEDIAN, OUT_SQUARE, OUT_AWAY, OUT_SLOPE) = range(12)
OUT_PLANES = 12
GRAD_PLANES = 11

# Where each plane of an item's buffer begins: pixel position, ray direction and its inverse, thickness per unit of
# depth; then state and outputs. Unsigned, since a signed index might count from the end, and is not vectorized.
_X, _Y, _D, _R, _LENGTH, _THICK, _T, _SUM_X, _OUT = 0, 1, 2, 5, 8, 9, 10, 11, 12
_FORWARD_PLANES = _OUT + OUT_PLANES
_PLANE = tuple(np.uint64(plane * AREA) for plane in range(30))
_ONE, _HALF, _TWO, _ZERO = np.float32(1.0), np.float32(0.5), np.float32(2.0), np.float32(0.0)
_STOP, _LOG2, _TINY = np.float32(STOP), np.float32(np.log(2.0)), np.float32(1e-20)
_KNEE, _INVERSE_KNEE = np.float32(LINEAR_FROM), np.float32(1.0 / LINEAR_FROM)
_STEP = np.float32(1.0 / SAMPLES)
# exp(x) = exp(x / 16)^16 with a Taylor polynomial of degree 8: to 1e-7 where x > -8, and exact at zero.
_LOWEST, _SIXTEENTH = np.float32(-16.0), np.float32(1 / 16)
_E2, _E3, _E4, _E5 = np.float32(1 / 2), np.float32(1 / 6), np.float32(1 / 24), np.float32(1 / 120)
_E6, _E7, _E8 = np.float32(1 / 720), np.float32(1 / 5040), np.float32(1 / 40320)


@numba.njit(inline="always", fastmath=True)
def _expm1(x):
    """exp(x) - 1 for x in [-16, 0], precise near zero too: a voxel that a ray misses stops no light; smaller x give that of -16."""
    t = max(x, _LOWEST) * _SIXTEENTH
    y = t * (_ONE + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    y = y * (y + _TWO)
    y = y * (y + _TWO)
    y = y * (y + _TWO)
    return y * (y + _TWO)


@numba.njit(inline="always", fastmath=True)
def _exp(x):
    """exp(x) for x in [-16, 0]; smaller x give exp(-16)."""
    t = max(x, _LOWEST) * _SIXTEENTH
    y = _ONE + t * (_ONE + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    y = y * y
    y = y * y
    y = y * y
    return y * y


@numba.njit(inline="always", fastmath=True)
def _meet(x, y, d0, d1, d2, r0, r1, r2, x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min):
    """Where a ray meets a voxel: the point e at the depth of its centre, first tau, and the segment's length in tau, 0 for a miss."""
    dx, dy = x - x0, y - y0
    e0, e1, e2 = c0 + a0 * dx + b0 * dy, c1 + a1 * dx + b1 * dy, c2 + a2 * dx + b2 * dy
    m0, m1, m2 = -e0 * r0, -e1 * r1, -e2 * r2
    h0, h1, h2 = abs(r0) * _HALF, abs(r1) * _HALF, abs(r2) * _HALF
    first = max(max(m0 - h0, m1 - h1), max(m2 - h2, tau_min))
    last = min(min(m0 + h0, m1 + h1), m2 + h2)
    return e0, e1, e2, first, max(last - first, _ZERO)


@numba.njit(inline="always", fastmath=True)
def _value(u, v, w, p1, px, py, pz, pxy, pxz, pyz, pxyz):
    return p1 + px * u + v * (py + pxy * u) + w * (pz + pxz * u + v * (pyz + pxyz * u))


@numba.njit(cache=True, error_model="numpy")
def _load_pixels(b, tile_x, tile_y, camera, octant):
    """Pixel positions and rays of an item; pixels of other octants have no light left."""
    for i in range(AREA):
        x, y = tile_x * TILE_PX + i % TILE_PX + 0.5, tile_y * TILE_PX + i // TILE_PX + 0.5
        b[_X * AREA + i], b[_Y * AREA + i] = x, y
        total = 0.0
        for axis in range(3):
            d = ray_direction(camera, x, y, axis)
            b[(_D + axis) * AREA + i], b[(_R + axis) * AREA + i] = d, 1.0 / d
            total += d * d
        b[_LENGTH * AREA + i] = 1.0 / np.sqrt(total)
        b[_THICK * AREA + i] = np.sqrt(total) * DENSITY_SCALE / SAMPLES
        b[_T * AREA + i] = 1.0 if octant_of(camera, x, y) == octant else 0.0
        b[_SUM_X * AREA + i] = 0.0


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _forward_voxel(s, n0, n1, n2, b, first, last):
    """Blend one voxel into pixels first..last of the buffer; n0, n1, n2: its normal in the world."""
    x0, y0, tau_min, zc, size = s[X0], s[Y0], s[TAU_MIN], s[ZC], s[SIZE]
    a0, a1, a2, b0, b1, b2, c0, c1, c2 = s[A0], s[A1], s[A2], s[B0], s[B1], s[B2], s[C0], s[C1], s[C2]
    p1, px, py, pz, pxy, pxz, pyz, pxyz = s[P1], s[PX], s[PY], s[PZ], s[PXY], s[PXZ], s[PYZ], s[PXYZ]
    red, green, blue, nx, ny, nz = s[RED], s[GREEN], s[BLUE], s[NX], s[NY], s[NZ]
    square = red * red + green * green + blue * blue
    for i in range(np.uint64(first), np.uint64(last)):
        d0, d1, d2 = b[i + _PLANE[_D]], b[i + _PLANE[_D + 1]], b[i + _PLANE[_D + 2]]
        e0, e1, e2, tau, length = _meet(
            b[i], b[i + _PLANE[_Y]], d0, d1, d2, b[i + _PLANE[_R]], b[i + _PLANE[_R + 1]], b[i + _PLANE[_R + 2]],
            x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min,
        )  # fmt: skip
        total = _ZERO
        for k in range(SAMPLES):
            at = tau + length * ((np.float32(k) + _HALF) * _STEP)
            v = _value(e0 + at * d0, e1 + at * d1, e2 + at * d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
            total += v if v > _KNEE else _KNEE * _exp(v * _INVERSE_KNEE - _ONE)
        along = length * size
        x = total * along * b[i + _PLANE[_THICK]]
        t = b[i + _PLANE[_T]]
        x = x if t >= _STOP else _ZERO
        w = -t * _expm1(-x)
        b[i + _PLANE[_T]] = t - w
        z = zc + size * (tau + _HALF * length)
        b[i + _PLANE[_OUT + OUT_R]] += w * red
        b[i + _PLANE[_OUT + OUT_G]] += w * green
        b[i + _PLANE[_OUT + OUT_B]] += w * blue
        b[i + _PLANE[_OUT + OUT_DEPTH]] += w * z
        b[i + _PLANE[_OUT + OUT_NX]] += w * nx
        b[i + _PLANE[_OUT + OUT_NY]] += w * ny
        b[i + _PLANE[_OUT + OUT_NZ]] += w * nz
        b[i + _PLANE[_OUT + OUT_SQUARE]] += w * square
        b[i + _PLANE[_OUT + OUT_AWAY]] += w * max((n0 * d0 + n1 * d1 + n2 * d2) * b[i + _PLANE[_LENGTH]], _ZERO)
        before = b[i + _PLANE[_SUM_X]]
        after = before + x
        b[i + _PLANE[_SUM_X]] = after
        crosses = (before < _LOG2) & (after >= _LOG2)
        slope = along / max(x, _TINY)
        median = zc + size * tau + slope * (_LOG2 - before)
        b[i + _PLANE[_OUT + OUT_MEDIAN]] = median if crosses else b[i + _PLANE[_OUT + OUT_MEDIAN]]
        b[i + _PLANE[_OUT + OUT_SLOPE]] = slope if crosses else b[i + _PLANE[_OUT + OUT_SLOPE]]


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _alive(b):
    most = _ZERO
    for i in range(AREA):
        most = max(most, b[_T * AREA + i])
    return most >= _STOP


@numba.njit(cache=True)
def _rows(box, tile_y):
    """First and last pixel, in the tile, of the rows that the box meets."""
    top = max(box[2] - tile_y * TILE_PX, 0)
    bottom = min(box[3] - tile_y * TILE_PX, TILE_PX)
    return top * TILE_PX, bottom * TILE_PX


@numba.njit(cache=True)
def _world_normal(s, camera, axis):
    return np.float32(camera[axis] * s[NX] + camera[3 + axis] * s[NY] + camera[6 + axis] * s[NZ])


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_forward(rows, boxes, camera, item_tiles, item_octants, items, starts, voxel_of, tiles_x, workers, image):
    """Draw the items of `list_items` into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros."""
    for worker in numba.prange(workers):
        b = np.empty(_FORWARD_PLANES * AREA, np.float32)
        for position in range(worker, len(items), workers):
            item = items[position]
            octant = item_octants[item]
            tile_x, tile_y = item_tiles[item] % tiles_x, item_tiles[item] // tiles_x
            b[:] = 0.0
            _load_pixels(b, tile_x, tile_y, camera, octant)
            for entry in range(starts[item], starts[item + 1]):
                if (entry - starts[item]) % 8 == 7 and not _alive(b):
                    break
                i = voxel_of[entry]
                first, last = _rows(boxes[i], tile_y)
                s = rows[i]
                n0, n1, n2 = _world_normal(s, camera, 0), _world_normal(s, camera, 1), _world_normal(s, camera, 2)
                _forward_voxel(s, n0, n1, n2, b, first, last)
            for i in range(AREA):
                y, x = tile_y * TILE_PX + i // TILE_PX, tile_x * TILE_PX + i % TILE_PX
                if octant_of(camera, x + 0.5, y + 0.5) == octant:
                    b[(_OUT + OUT_ALPHA) * AREA + i] = _ONE - b[_T * AREA + i]
                    for plane in range(OUT_PLANES):
                        image[plane, y, x] = b[(_OUT + plane) * AREA + i]


# Planes of the backward buffer after the forward pass's state: running sum, its total, the median's slope, gradients.
_SUM, _TOTAL, _SLOPE, _WEIGHT, _G = 12, 13, 14, 15, 16
_BACKWARD_PLANES = _G + GRAD_PLANES


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _backward_voxel(s, n0, n1, n2, b, first, last, away, out):
    """Gradients of one voxel over pixels first..last of an item, into out (16,); away (3,) by the normal in the world."""
    x0, y0, tau_min, zc, size = s[X0], s[Y0], s[TAU_MIN], s[ZC], s[SIZE]
    a0, a1, a2, b0, b1, b2, c0, c1, c2 = s[A0], s[A1], s[A2], s[B0], s[B1], s[B2], s[C0], s[C1], s[C2]
    p1, px, py, pz, pxy, pxz, pyz, pxyz = s[P1], s[PX], s[PY], s[PZ], s[PXY], s[PXZ], s[PYZ], s[PXYZ]
    red, green, blue, nx, ny, nz = s[RED], s[GREEN], s[BLUE], s[NX], s[NY], s[NZ]
    square = red * red + green * green + blue * blue
    g_1 = g_x = g_y = g_z = g_xy = g_xz = g_yz = g_xyz = _ZERO
    g_red = g_green = g_blue = g_nx = g_ny = g_nz = g_a0 = g_a1 = g_a2 = g_square = priority = _ZERO
    for i in range(np.uint64(first), np.uint64(last)):
        d0, d1, d2 = b[i + _PLANE[_D]], b[i + _PLANE[_D + 1]], b[i + _PLANE[_D + 2]]
        e0, e1, e2, tau, length = _meet(
            b[i], b[i + _PLANE[_Y]], d0, d1, d2, b[i + _PLANE[_R]], b[i + _PLANE[_R + 1]], b[i + _PLANE[_R + 2]],
            x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min,
        )  # fmt: skip
        total = _ZERO
        for k in range(SAMPLES):
            at = tau + length * ((np.float32(k) + _HALF) * _STEP)
            v = _value(e0 + at * d0, e1 + at * d1, e2 + at * d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
            total += v if v > _KNEE else _KNEE * _exp(v * _INVERSE_KNEE - _ONE)
        t = b[i + _PLANE[_T]]
        along = length * size
        thick = along * b[i + _PLANE[_THICK]]
        thick = thick if t >= _STOP else _ZERO
        x = total * thick
        alpha = -_expm1(-x)
        w = t * alpha
        z = zc + size * (tau + _HALF * length)
        gr, gg, gb = b[i + _PLANE[_G]], b[i + _PLANE[_G + 1]], b[i + _PLANE[_G + 2]]
        gnx, gny, gnz = b[i + _PLANE[_G + 4]], b[i + _PLANE[_G + 5]], b[i + _PLANE[_G + 6]]
        g_two, g_away = b[i + _PLANE[_G + OUT_SQUARE]], b[i + _PLANE[_G + OUT_AWAY]]
        cosine = (n0 * d0 + n1 * d1 + n2 * d2) * b[i + _PLANE[_LENGTH]]
        value = gr * red + gg * green + gb * blue + gnx * nx + gny * ny + gnz * nz + b[i + _PLANE[_G + OUT_ALPHA]]
        value += b[i + _PLANE[_G + OUT_DEPTH]] * z + g_two * square + g_away * max(cosine, _ZERO)
        through = b[i + _PLANE[_SUM]] + w * value
        b[i + _PLANE[_SUM]] = through
        d_x = (t - w) * value - (b[i + _PLANE[_TOTAL]] - through)
        before = b[i + _PLANE[_SUM_X]]
        after = before + x
        b[i + _PLANE[_SUM_X]] = after
        b[i + _PLANE[_T]] = t - w
        # The depth at which half of the light is gone moves nearer with every thickness before it.
        share = _ONE if after < _LOG2 else (_LOG2 - before) / max(x, _TINY)
        share = share if before < _LOG2 else _ZERO
        d_x -= b[i + _PLANE[_G + OUT_MEDIAN]] * b[i + _PLANE[_SLOPE]] * share
        d_each = d_x * thick
        for k in range(SAMPLES):
            at = tau + length * ((np.float32(k) + _HALF) * _STEP)
            u0, u1, u2 = e0 + at * d0, e1 + at * d1, e2 + at * d2
            v = _value(u0, u1, u2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
            d_v = d_each * (_ONE if v > _KNEE else _exp(v * _INVERSE_KNEE - _ONE))
            g_1 += d_v
            g_x += d_v * u0
            g_y += d_v * u1
            g_z += d_v * u2
            g_xy += d_v * (u0 * u1)
            g_xz += d_v * (u0 * u2)
            g_yz += d_v * (u1 * u2)
            g_xyz += d_v * (u0 * u1 * u2)
        g_red += w * gr
        g_green += w * gg
        g_blue += w * gb
        g_square += w * g_two
        g_nx += w * gnx
        g_ny += w * gny
        g_nz += w * gnz
        d_cosine = w * g_away * b[i + _PLANE[_LENGTH]] if cosine > _ZERO else _ZERO
        g_a0 += d_cosine * d0
        g_a1 += d_cosine * d1
        g_a2 += d_cosine * d2
        b[i + _PLANE[_WEIGHT]] = w
        # |alpha d loss / d alpha|, where d alpha = exp(-x) dx.
        priority += abs(d_x) * alpha / max(_ONE - alpha, _STOP)
    out[G_P], out[G_P + 1], out[G_P + 2], out[G_P + 3] = g_1, g_x, g_y, g_z
    out[G_P + 4], out[G_P + 5], out[G_P + 6], out[G_P + 7] = g_xy, g_xz, g_yz, g_xyz
    out[G_RED], out[G_RED + 1] = g_red + _TWO * red * g_square, g_green + _TWO * green * g_square
    out[G_RED + 2] = g_blue + _TWO * blue * g_square
    out[G_NX], out[G_NX + 1], out[G_NX + 2] = g_nx, g_ny, g_nz
    out[G_PRIORITY] = priority
    away[0], away[1], away[2] = g_a0, g_a1, g_a2
    # A maximum within the loop above would keep the compiler from using vector instructions.
    most = _ZERO
    for i in range(np.uint64(first), np.uint64(last)):
        most = max(most, b[i + _PLANE[_WEIGHT]])
    out[G_WEIGHT] = most


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_backward(
    rows, boxes, camera, item_tiles, item_octants, items, starts, voxel_of, slot_of, slot_starts, tiles_x, workers, image, gradient, out
):
    """Gradients of the loss by the voxel rows.

    Args:
        image: (12, height, width) as `blend_forward` left it.
        gradient: (11, height, width) float32, the loss's derivative by the first eleven planes.
        out: (N, 16) float32, overwritten; its last two columns are the largest blending weight and the priority.
    """
    slots = np.zeros((len(voxel_of), GRADIENT_WIDTH), np.float32)
    for worker in numba.prange(workers):
        b, away = np.empty(_BACKWARD_PLANES * AREA, np.float32), np.empty(3, np.float32)
        for position in range(worker, len(items), workers):
            item = items[position]
            tile_x, tile_y = item_tiles[item] % tiles_x, item_tiles[item] // tiles_x
            _load_pixels(b, tile_x, tile_y, camera, item_octants[item])
            b[_SUM * AREA : (_SUM + 1) * AREA] = 0.0
            for i in range(AREA):
                y, x = tile_y * TILE_PX + i // TILE_PX, tile_x * TILE_PX + i % TILE_PX
                total = _ZERO
                for plane in range(GRAD_PLANES):
                    b[(_G + plane) * AREA + i] = gradient[plane, y, x]
                    if plane != OUT_MEDIAN:
                        total += gradient[plane, y, x] * image[plane, y, x]
                b[_TOTAL * AREA + i] = total
                b[_SLOPE * AREA + i] = image[OUT_SLOPE, y, x]
            for entry in range(starts[item], starts[item + 1]):
                if (entry - starts[item]) % 8 == 7 and not _alive(b):
                    break
                i = voxel_of[entry]
                first, last = _rows(boxes[i], tile_y)
                s = rows[i]
                n0, n1, n2 = _world_normal(s, camera, 0), _world_normal(s, camera, 1), _world_normal(s, camera, 2)
                slot = slots[slot_of[entry]]
                _backward_voxel(s, n0, n1, n2, b, first, last, away, slot)
                for r in range(3):
                    slot[G_NX + r] += camera[3 * r] * away[0] + camera[3 * r + 1] * away[1] + camera[3 * r + 2] * away[2]
    for i in numba.prange(len(rows)):
        for column in range(GRADIENT_WIDTH):
            total = _ZERO
            for slot in range(slot_starts[i], slot_starts[i + 1]):
                total = max(total, slots[slot, column]) if column == G_WEIGHT else total + slots[slot, column]
            out[i, column] = total
