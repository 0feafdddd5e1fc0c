"""The forward CPU kernel of sparse voxels: blend voxels front to back (Sun et al. 2025, sec. 3.1).

Each pair, a tile of 16 x 16 pixels and an octant of ray directions, is drawn by one thread. Inside, a voxel visits the
blocks of 4 x 4 pixels that its box meets and that are not opaque yet, and notes them for the backward pass. The loop over the
pixels of a block becomes vector instructions.

A ray meets a voxel in a segment of length l; its optical thickness is x = l / K * sum_k sigma(v_k) over K samples of the
interpolated value v, sigma the exponential-linear activation, and its opacity 1 - exp(-x).
"""

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import ACROSS, BIT, BLOCK_PX, BLOCKS, HALF, LANES, ONE, PLANE, STOP, TILE_PX, ZERO
from zeroshop_steps.surface.svraster.kernels import layout as at
from zeroshop_steps.surface.svraster.kernels.intersection import DENSITY_SCALE, SAMPLES, expm1, intersect_voxel, sum_densities
from zeroshop_steps.surface.svraster.kernels.tiles import octant_of, ray_direction

_OUT = at.OWN
_PLANES = _OUT + at.OUT_PLANES
LOG2, TINY = np.float32(np.log(2.0)), np.float32(1e-20)


@numba.njit(cache=True, forceinline=True, error_model="numpy")
def load_pixels(b, planes, tile_x, tile_y, camera, octant):
    """Fill the first twelve planes of an pair's blocks; pixels of other octants have no light left. Returns the lit blocks."""
    living = np.uint64(0)
    for block in range(BLOCKS):
        for lane in range(LANES):
            i = block * planes * LANES + lane
            x = tile_x * TILE_PX + block % ACROSS * BLOCK_PX + lane % BLOCK_PX + 0.5
            y = tile_y * TILE_PX + block // ACROSS * BLOCK_PX + lane // BLOCK_PX + 0.5
            b[i + at.X * LANES], b[i + at.Y * LANES] = x, y
            total = 0.0
            for axis in range(3):
                d = ray_direction(camera, x, y, axis)
                b[i + (at.D + axis) * LANES], b[i + (at.R + axis) * LANES] = d, 1.0 / d
                total += d * d
            b[i + at.LENGTH * LANES] = 1.0 / np.sqrt(total)
            b[i + at.THICK * LANES] = np.sqrt(total) * DENSITY_SCALE / SAMPLES
            own = octant_of(camera, x, y) == octant
            b[i + at.T * LANES] = 1.0 if own else 0.0
            b[i + at.SUM_X * LANES] = 0.0
            if own:
                living |= np.uint64(1 << block)
    return living


@numba.njit(cache=True, forceinline=True)
def blocks_of(boxes, i, tile_x, tile_y):
    """The blocks of a tile that the pixel box i meets, one bit a block: bit 4 y + x."""
    left, right = max(boxes[i, 0] - tile_x * TILE_PX, 0) // BLOCK_PX, -(-min(boxes[i, 1] - tile_x * TILE_PX, TILE_PX) // BLOCK_PX)
    top, bottom = max(boxes[i, 2] - tile_y * TILE_PX, 0) // BLOCK_PX, -(-min(boxes[i, 3] - tile_y * TILE_PX, TILE_PX) // BLOCK_PX)
    # One bit for each row of blocks, times the bits of a row.
    return np.uint64(((1 << ACROSS * bottom) - (1 << ACROSS * top)) // ((1 << ACROSS) - 1) * ((1 << right) - (1 << left)))


@numba.njit(cache=True, forceinline=True)
def world_normal(rows, i, camera, axis):
    """A voxel's normal along one axis of the world."""
    return np.float32(camera[axis] * rows[i, at.NX] + camera[3 + axis] * rows[i, at.NY] + camera[6 + axis] * rows[i, at.NZ])


@numba.njit(cache=True, forceinline=True, fastmath=True, error_model="numpy")
def _blend_voxel(rows, index, n0, n1, n2, b, blocks):
    """Blend one voxel into some blocks (one bit a block) of an pair's buffer; returns those that no light passes any more.

    n0, n1, n2: its normal in the world.
    """
    x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min = at.box_of(rows, index)
    p1, px, py, pz, pxy, pxz, pyz, pxyz = at.polynomial_of(rows, index)
    zc, size, red, green, blue, nx, ny, nz = at.look_of(rows, index)
    square = red * red + green * green + blue * blue
    dark = np.uint64(0)
    while blocks:
        rest = blocks & (blocks - np.uint64(1))
        bit = blocks ^ rest
        blocks = rest
        first = BIT[bit % np.uint64(19)] * np.uint64(_PLANES * LANES)
        lit = ZERO
        for i in range(first, first + np.uint64(LANES)):
            d0, d1, d2 = b[i + PLANE[at.D]], b[i + PLANE[at.D + 1]], b[i + PLANE[at.D + 2]]
            e0, e1, e2, tau, length = intersect_voxel(
                b[i], b[i + PLANE[at.Y]], d0, d1, d2, b[i + PLANE[at.R]], b[i + PLANE[at.R + 1]], b[i + PLANE[at.R + 2]],
                x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min,
            )  # fmt: skip
            total = sum_densities(e0, e1, e2, tau, length, d0, d1, d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
            along = length * size
            x = total * along * b[i + PLANE[at.THICK]]
            t = b[i + PLANE[at.T]]
            x = x if t >= STOP else ZERO
            w = -t * expm1(-x)
            b[i + PLANE[at.T]] = t - w
            lit += ONE if t - w >= STOP else ZERO
            z = zc + size * (tau + HALF * length)
            b[i + PLANE[_OUT + at.OUT_R]] += w * red
            b[i + PLANE[_OUT + at.OUT_G]] += w * green
            b[i + PLANE[_OUT + at.OUT_B]] += w * blue
            b[i + PLANE[_OUT + at.OUT_DEPTH]] += w * z
            b[i + PLANE[_OUT + at.OUT_NX]] += w * nx
            b[i + PLANE[_OUT + at.OUT_NY]] += w * ny
            b[i + PLANE[_OUT + at.OUT_NZ]] += w * nz
            b[i + PLANE[_OUT + at.OUT_SQUARE]] += w * square
            b[i + PLANE[_OUT + at.OUT_AWAY]] += w * max((n0 * d0 + n1 * d1 + n2 * d2) * b[i + PLANE[at.LENGTH]], ZERO)
            before = b[i + PLANE[at.SUM_X]]
            after = before + x
            b[i + PLANE[at.SUM_X]] = after
            crosses = (before < LOG2) & (after >= LOG2)
            slope = along / max(x, TINY)
            median = zc + size * tau + slope * (LOG2 - before)
            b[i + PLANE[_OUT + at.OUT_MEDIAN]] = median if crosses else b[i + PLANE[_OUT + at.OUT_MEDIAN]]
            b[i + PLANE[_OUT + at.OUT_SLOPE]] = slope if crosses else b[i + PLANE[_OUT + at.OUT_SLOPE]]
        dark |= np.uint64(0) if lit > ZERO else bit
    return dark


@numba.njit(cache=True, parallel=True, error_model="numpy")
def blend_forward(rows, boxes, camera, pair_tiles, pair_octants, pairs, starts, voxel_of, slot_of, tiles_x, workers, image, blocks):
    """Draw the pairs of `list_voxels_by_tile` into image (12, tiles_y * 16, tiles_x * 16) float32, which must hold zeros.

    blocks: (E,) uint16, filled, by slot, with the blocks that meet the voxel and that light reaches.
    """
    for worker in numba.prange(workers):
        b = np.empty(_PLANES * LANES * BLOCKS, np.float32)
        for position in range(worker, len(pairs), workers):
            pair = pairs[position]
            octant = pair_octants[pair]
            tile_x, tile_y = pair_tiles[pair] % tiles_x, pair_tiles[pair] // tiles_x
            b[:] = 0.0
            living = load_pixels(b, _PLANES, tile_x, tile_y, camera, octant)
            for entry in range(starts[pair], starts[pair + 1]):
                i = voxel_of[entry]
                met = blocks_of(boxes, i, tile_x, tile_y) & living
                blocks[slot_of[entry]] = met
                if met:
                    n0, n1, n2 = world_normal(rows, i, camera, 0), world_normal(rows, i, camera, 1), world_normal(rows, i, camera, 2)
                    living &= ~_blend_voxel(rows, i, n0, n1, n2, b, met)
            for block in range(BLOCKS):
                for lane in range(LANES):
                    y = tile_y * TILE_PX + block // ACROSS * BLOCK_PX + lane // BLOCK_PX
                    x = tile_x * TILE_PX + block % ACROSS * BLOCK_PX + lane % BLOCK_PX
                    if octant_of(camera, x + 0.5, y + 0.5) == octant:
                        i = block * _PLANES * LANES + lane
                        b[i + (_OUT + at.OUT_ALPHA) * LANES] = ONE - b[i + at.T * LANES]
                        for plane in range(at.OUT_PLANES):
                            image[plane, y, x] = b[i + (_OUT + plane) * LANES]
