"""The forward CPU kernel of 2D Gaussian Splatting: blend splats front to back.

Each tile of 16 x 16 pixels is drawn by one thread. A splat visits the blocks of 4 x 4 pixels that its footprint meets and
that are not opaque yet, and notes them for the backward pass. The loop over the pixels of a block becomes vector instructions;
the planes of a block lie one behind the other in one buffer, so that the compiler can prove loads and stores apart.
"""

from collections.abc import Callable

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import ACROSS, BIT, BLOCK_PX, BLOCKS, HALF, LANES, ONE, PLANE, STOP, TILE_PX, TWO, ZERO
from zeroshop_steps.surface.twodgs.kernels import layout as at
from zeroshop_steps.surface.twodgs.kernels.intersection import intersect_surfel
from zeroshop_steps.surface.twodgs.kernels.project import ALPHA_MIN

CUT = np.float32(ALPHA_MIN)
ALPHA_MAX = np.float32(0.99)

# Planes of a block's buffer: x, y, transmittance, then the outputs.
_T, _OUT = 2, 3
_PLANES = _OUT + at.OUT_PLANES


@numba.njit(cache=True, forceinline=True)
def load_pixels(b, planes, tile_x, tile_y):
    """Fill the first three planes of every block of a tile: pixel positions and light, which is whole."""
    for block in range(BLOCKS):
        for lane in range(LANES):
            i = block * planes * LANES + lane
            b[i] = np.float32(tile_x * TILE_PX + block % ACROSS * BLOCK_PX + lane % BLOCK_PX) + HALF
            b[i + LANES] = np.float32(tile_y * TILE_PX + block // ACROSS * BLOCK_PX + lane // BLOCK_PX) + HALF
            b[i + 2 * LANES] = ONE


def _splat_kernel(distortion: bool) -> Callable:
    """The kernel of one splat, with or without the distortion sum, which few losses need: decided when it is compiled."""

    @numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
    def blend_splat(splats, index, b, blocks, k1, k2):
        """Blend splat `index` into some blocks (one bit a block) of a tile's buffer; returns those that no light passes any more."""
        cx, cy, u1, u2, v1, v2, a1, a2 = at.shape_of(splats, index)
        zc, opacity, red, green, blue, nx, ny, nz = at.look_of(splats, index)
        k2_zc = k2 / zc
        dark = np.uint64(0)
        while blocks:
            rest = blocks & (blocks - np.uint64(1))
            bit = blocks ^ rest
            blocks = rest
            first = BIT[bit % np.uint64(19)] * np.uint64(_PLANES * LANES)
            lit = ZERO
            for i in range(first, first + np.uint64(LANES)):
                dx = b[i] - cx
                dy = b[i + PLANE[1]] - cy
                _, a, r, _, _, _, e = intersect_surfel(dx, dy, u1, u2, v1, v2, a1, a2)
                z = zc * r
                alpha = min(opacity * e, ALPHA_MAX)
                t = b[i + PLANE[_T]]
                visible = (alpha >= CUT) & (t >= STOP)
                w = t * alpha if visible else ZERO
                b[i + PLANE[_T]] = t - w
                lit += ONE if t - w >= STOP else ZERO
                b[i + PLANE[_OUT + at.OUT_R]] += w * red
                b[i + PLANE[_OUT + at.OUT_G]] += w * green
                b[i + PLANE[_OUT + at.OUT_B]] += w * blue
                b[i + PLANE[_OUT + at.OUT_DEPTH]] += w * z
                b[i + PLANE[_OUT + at.OUT_NX]] += w * nx
                b[i + PLANE[_OUT + at.OUT_NY]] += w * ny
                b[i + PLANE[_OUT + at.OUT_NZ]] += w * nz
                b[i + PLANE[_OUT + at.OUT_MEDIAN]] = z if visible & (t > HALF) else b[i + PLANE[_OUT + at.OUT_MEDIAN]]
                if distortion:
                    m = k1 - k2_zc * a
                    m1, m2 = b[i + PLANE[_OUT + at.OUT_M1]], b[i + PLANE[_OUT + at.OUT_M2]]
                    b[i + PLANE[_OUT + at.OUT_DISTORTION]] += w * (m * m * (ONE - t) + m2 - TWO * m * m1)
                    b[i + PLANE[_OUT + at.OUT_M1]] = m1 + w * m
                    b[i + PLANE[_OUT + at.OUT_M2]] = m2 + w * m * m
            dark |= np.uint64(0) if lit > ZERO else bit
        return dark

    return blend_splat


_blend_splat, _blend_splat_with_distortion = _splat_kernel(False), _splat_kernel(True)


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_forward(splats, tiles, starts, splat_of, slot_of, blocks, tiles_x, distortion, k1, k2, workers, image):
    """Draw the tiles of `list_splats_by_tile` into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros.

    distortion: whether to fill the last three planes. The mapped depth of the distortion term is k1 - k2 / z.
    blocks: those of `list_splats_by_tile`; ones that no light reaches are cleared, for the backward pass.
    """
    for worker in numba.prange(workers):
        b = np.empty(_PLANES * LANES * BLOCKS, np.float32)
        for position in range(worker, len(tiles), workers):
            tile = tiles[position]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            b[:] = 0.0
            load_pixels(b, _PLANES, tile_x, tile_y)
            living = np.uint64((1 << BLOCKS) - 1)
            for entry in range(starts[tile], starts[tile + 1]):
                slot = slot_of[entry]
                met = np.uint64(blocks[slot]) & living
                blocks[slot] = met
                if met:
                    i = splat_of[entry]
                    if distortion:
                        living &= ~_blend_splat_with_distortion(splats, i, b, met, k1, k2)
                    else:
                        living &= ~_blend_splat(splats, i, b, met, k1, k2)
            for block in range(BLOCKS):
                y0, x0 = tile_y * TILE_PX + block // ACROSS * BLOCK_PX, tile_x * TILE_PX + block % ACROSS * BLOCK_PX
                start = block * _PLANES * LANES
                for lane in range(LANES):
                    b[start + (_OUT + at.OUT_ALPHA) * LANES + lane] = ONE - b[start + _T * LANES + lane]
                for plane in range(at.OUT_PLANES):
                    for lane in range(LANES):
                        image[plane, y0 + lane // BLOCK_PX, x0 + lane % BLOCK_PX] = b[start + (_OUT + plane) * LANES + lane]
