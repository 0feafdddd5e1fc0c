"""The backward CPU kernel of sparse voxels: carry gradients of the image back to the voxels' rows.

It goes front to back too. With u_i the derivative of the loss by the blending weight w_i = T_i (1 - exp(-x_i)), x_i the
optical thickness,

    d loss / d x_i = T_i exp(-x_i) u_i - sum_{j > i} w_j u_j,

and the sum over the voxels behind is the total, known from the forward pass, less the running sum.
Gradients go to one row for each (pair, voxel) pair, which are then summed in fixed order: same bytes every run.
"""

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import ACROSS, BIT, BLOCK_PX, BLOCKS, HALF, LANES, ONE, PLANE, STOP, TILE_PX, TWO, ZERO
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
    SIZE,
    TAU_MIN,
    X0,
    Y0,
    ZC,
)  # fmt: skip
from zeroshop_steps.surface.svraster.kernels.rasterize import (
    GRAD_PLANES,
    INVERSE_KNEE,
    KNEE,
    LENGTH,
    LOG2,
    OUT_ALPHA,
    OUT_AWAY,
    OUT_DEPTH,
    OUT_MEDIAN,
    OUT_SLOPE,
    OUT_SQUARE,
    SAMPLES,
    STEP,
    SUM_X,
    THICK,
    TINY,
    D,
    R,
    T,
    Y,
    load_pixels,
    world_normal,
)  # fmt: skip

# Planes of a block's buffer after the ones that `load_pixels` fills: running sum, its total, the median's slope, gradients.
_SUM, _TOTAL, _SLOPE, _G = 12, 13, 14, 15
_PLANES = _G + GRAD_PLANES
# Of the sums: the largest weight comes last.
_LARGEST, _SUMS = 19, 20


@numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
def _differentiate_voxel(rows, index, n0, n1, n2, b, sums, blocks, away, out, slot):
    """Gradients of one voxel over some blocks (one bit a block) of an pair, into row `slot` of out; sums (20 * 16,) holds zeros.

    n0, n1, n2: its normal in the world; away (3,): filled with the gradient by it.
    """
    x0, y0, tau_min, zc, size = rows[index, X0], rows[index, Y0], rows[index, TAU_MIN], rows[index, ZC], rows[index, SIZE]
    a0, a1, a2, b0, b1, b2, c0, c1, c2 = (
        rows[index, A0],
        rows[index, A1],
        rows[index, A2],
        rows[index, B0],
        rows[index, B1],
        rows[index, B2],
        rows[index, C0],
        rows[index, C1],
        rows[index, C2],
    )
    p1, px, py, pz, pxy, pxz, pyz, pxyz = (
        rows[index, P1],
        rows[index, PX],
        rows[index, PY],
        rows[index, PZ],
        rows[index, PXY],
        rows[index, PXZ],
        rows[index, PYZ],
        rows[index, PXYZ],
    )
    red, green, blue, nx, ny, nz = (
        rows[index, RED],
        rows[index, GREEN],
        rows[index, BLUE],
        rows[index, NX],
        rows[index, NY],
        rows[index, NZ],
    )
    square = red * red + green * green + blue * blue
    while blocks:
        rest = blocks & (blocks - np.uint64(1))
        first = BIT[(blocks ^ rest) % np.uint64(19)] * np.uint64(_PLANES * LANES)
        blocks = rest
        for lane in range(np.uint64(LANES)):
            i = first + lane
            d0, d1, d2 = b[i + PLANE[D]], b[i + PLANE[D + 1]], b[i + PLANE[D + 2]]
            e0, e1, e2, tau, length = intersect_voxel(
                b[i], b[i + PLANE[Y]], d0, d1, d2, b[i + PLANE[R]], b[i + PLANE[R + 1]], b[i + PLANE[R + 2]],
                x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min,
            )  # fmt: skip
            total = ZERO
            for k in range(SAMPLES):
                at = tau + length * ((np.float32(k) + HALF) * STEP)
                v = interpolate_density(e0 + at * d0, e1 + at * d1, e2 + at * d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
                total += v if v > KNEE else KNEE * exp(v * INVERSE_KNEE - ONE)
            t = b[i + PLANE[T]]
            along = length * size
            thick = along * b[i + PLANE[THICK]]
            thick = thick if t >= STOP else ZERO
            x = total * thick
            alpha = -expm1(-x)
            w = t * alpha
            z = zc + size * (tau + HALF * length)
            gr, gg, gb = b[i + PLANE[_G]], b[i + PLANE[_G + 1]], b[i + PLANE[_G + 2]]
            gnx, gny, gnz = b[i + PLANE[_G + 4]], b[i + PLANE[_G + 5]], b[i + PLANE[_G + 6]]
            g_two, g_away = b[i + PLANE[_G + OUT_SQUARE]], b[i + PLANE[_G + OUT_AWAY]]
            cosine = (n0 * d0 + n1 * d1 + n2 * d2) * b[i + PLANE[LENGTH]]
            value = gr * red + gg * green + gb * blue + gnx * nx + gny * ny + gnz * nz + b[i + PLANE[_G + OUT_ALPHA]]
            value += b[i + PLANE[_G + OUT_DEPTH]] * z + g_two * square + g_away * max(cosine, ZERO)
            through = b[i + PLANE[_SUM]] + w * value
            b[i + PLANE[_SUM]] = through
            d_x = (t - w) * value - (b[i + PLANE[_TOTAL]] - through)
            before = b[i + PLANE[SUM_X]]
            after = before + x
            b[i + PLANE[SUM_X]] = after
            b[i + PLANE[T]] = t - w
            # The depth at which half of the light is gone moves nearer with every thickness before it.
            share = ONE if after < LOG2 else (LOG2 - before) / max(x, TINY)
            share = share if before < LOG2 else ZERO
            d_x -= b[i + PLANE[_G + OUT_MEDIAN]] * b[i + PLANE[_SLOPE]] * share
            d_each = d_x * thick
            for k in range(SAMPLES):
                at = tau + length * ((np.float32(k) + HALF) * STEP)
                u0, u1, u2 = e0 + at * d0, e1 + at * d1, e2 + at * d2
                v = interpolate_density(u0, u1, u2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
                d_v = d_each * (ONE if v > KNEE else exp(v * INVERSE_KNEE - ONE))
                sums[lane + PLANE[0]] += d_v
                sums[lane + PLANE[1]] += d_v * u0
                sums[lane + PLANE[2]] += d_v * u1
                sums[lane + PLANE[3]] += d_v * u2
                sums[lane + PLANE[4]] += d_v * (u0 * u1)
                sums[lane + PLANE[5]] += d_v * (u0 * u2)
                sums[lane + PLANE[6]] += d_v * (u1 * u2)
                sums[lane + PLANE[7]] += d_v * (u0 * u1 * u2)
            sums[lane + PLANE[8]] += w * gr
            sums[lane + PLANE[9]] += w * gg
            sums[lane + PLANE[10]] += w * gb
            sums[lane + PLANE[17]] += w * g_two
            sums[lane + PLANE[11]] += w * gnx
            sums[lane + PLANE[12]] += w * gny
            sums[lane + PLANE[13]] += w * gnz
            d_cosine = w * g_away * b[i + PLANE[LENGTH]] if cosine > ZERO else ZERO
            sums[lane + PLANE[14]] += d_cosine * d0
            sums[lane + PLANE[15]] += d_cosine * d1
            sums[lane + PLANE[16]] += d_cosine * d2
            sums[lane + PLANE[_LARGEST]] = max(sums[lane + PLANE[_LARGEST]], w)
            # |alpha d loss / d alpha|, where d alpha = exp(-x) dx.
            sums[lane + PLANE[18]] += abs(d_x) * alpha / max(ONE - alpha, STOP)
    # One loop for all sums, which leaves zeros behind: the compiler sums the registers across at once.
    g_1 = g_x = g_y = g_z = g_xy = g_xz = g_yz = g_xyz = ZERO
    g_red = g_green = g_blue = g_nx = g_ny = g_nz = g_a0 = g_a1 = g_a2 = g_square = priority = ZERO
    for lane in range(np.uint64(LANES)):
        g_1 += sums[lane + PLANE[0]]
        sums[lane + PLANE[0]] = ZERO
        g_x += sums[lane + PLANE[1]]
        sums[lane + PLANE[1]] = ZERO
        g_y += sums[lane + PLANE[2]]
        sums[lane + PLANE[2]] = ZERO
        g_z += sums[lane + PLANE[3]]
        sums[lane + PLANE[3]] = ZERO
        g_xy += sums[lane + PLANE[4]]
        sums[lane + PLANE[4]] = ZERO
        g_xz += sums[lane + PLANE[5]]
        sums[lane + PLANE[5]] = ZERO
        g_yz += sums[lane + PLANE[6]]
        sums[lane + PLANE[6]] = ZERO
        g_xyz += sums[lane + PLANE[7]]
        sums[lane + PLANE[7]] = ZERO
        g_red += sums[lane + PLANE[8]]
        sums[lane + PLANE[8]] = ZERO
        g_green += sums[lane + PLANE[9]]
        sums[lane + PLANE[9]] = ZERO
        g_blue += sums[lane + PLANE[10]]
        sums[lane + PLANE[10]] = ZERO
        g_nx += sums[lane + PLANE[11]]
        sums[lane + PLANE[11]] = ZERO
        g_ny += sums[lane + PLANE[12]]
        sums[lane + PLANE[12]] = ZERO
        g_nz += sums[lane + PLANE[13]]
        sums[lane + PLANE[13]] = ZERO
        g_a0 += sums[lane + PLANE[14]]
        sums[lane + PLANE[14]] = ZERO
        g_a1 += sums[lane + PLANE[15]]
        sums[lane + PLANE[15]] = ZERO
        g_a2 += sums[lane + PLANE[16]]
        sums[lane + PLANE[16]] = ZERO
        g_square += sums[lane + PLANE[17]]
        sums[lane + PLANE[17]] = ZERO
        priority += sums[lane + PLANE[18]]
        sums[lane + PLANE[18]] = ZERO
    largest = ZERO
    for lane in range(np.uint64(LANES)):
        largest = max(largest, sums[lane + PLANE[_LARGEST]])
        sums[lane + PLANE[_LARGEST]] = ZERO
    out[slot, G_P], out[slot, G_P + 1], out[slot, G_P + 2], out[slot, G_P + 3] = g_1, g_x, g_y, g_z
    out[slot, G_P + 4], out[slot, G_P + 5], out[slot, G_P + 6], out[slot, G_P + 7] = g_xy, g_xz, g_yz, g_xyz
    out[slot, G_RED], out[slot, G_RED + 1] = g_red + TWO * red * g_square, g_green + TWO * green * g_square
    out[slot, G_RED + 2] = g_blue + TWO * blue * g_square
    out[slot, G_NX], out[slot, G_NX + 1], out[slot, G_NX + 2] = g_nx, g_ny, g_nz
    out[slot, G_PRIORITY], out[slot, G_WEIGHT] = priority, largest
    away[0], away[1], away[2] = g_a0, g_a1, g_a2


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
        b, sums, away = np.empty(_PLANES * LANES * BLOCKS, np.float32), np.zeros(_SUMS * LANES, np.float32), np.empty(3, np.float32)
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
                        if plane != OUT_MEDIAN:
                            total += gradient[plane, y, x] * image[plane, y, x]
                    b[i + _SUM * LANES] = ZERO
                    b[i + _TOTAL * LANES] = total
                    b[i + _SLOPE * LANES] = image[OUT_SLOPE, y, x]
            for entry in range(starts[pair], starts[pair + 1]):
                i, slot = voxel_of[entry], slot_of[entry]
                met = np.uint64(blocks[slot])
                if met:
                    n0, n1, n2 = world_normal(rows, i, camera, 0), world_normal(rows, i, camera, 1), world_normal(rows, i, camera, 2)
                    _differentiate_voxel(rows, i, n0, n1, n2, b, sums, met, away, slots, slot)
                    for r in range(3):
                        slots[slot, G_NX + r] += camera[3 * r] * away[0] + camera[3 * r + 1] * away[1] + camera[3 * r + 2] * away[2]
    for i in numba.prange(len(rows)):
        seen[i] = False
        for column in range(GRADIENT_WIDTH):
            out[i, column] = ZERO
        for slot in range(slot_starts[i], slot_starts[i + 1]):
            if blocks[slot]:
                seen[i] = True
                largest = max(out[i, G_WEIGHT], slots[slot, G_WEIGHT])
                for column in range(GRADIENT_WIDTH):
                    out[i, column] += slots[slot, column]
                out[i, G_WEIGHT] = largest
