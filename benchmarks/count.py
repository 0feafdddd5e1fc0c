"""How many samples a view blends: pairs of a pixel and a primitive that adds to it, counted one by one."""

import math

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import TILE_PX
from zeroshop_steps.surface.svraster import render as voxel_render
from zeroshop_steps.surface.svraster.kernels import intersection
from zeroshop_steps.surface.svraster.kernels import layout as voxels
from zeroshop_steps.surface.svraster.kernels.tiles import octant_of, ray_direction
from zeroshop_steps.surface.twodgs import render as surfel_render
from zeroshop_steps.surface.twodgs.kernels import layout as surfels
from zeroshop_steps.surface.twodgs.kernels.project import ALPHA_MIN

LIGHT_MIN = 1e-4
"""Transmittance below which both optimizers end a pixel."""


def blended_samples(scene, view) -> int:
    """Pairs of a pixel and a surfel or voxel that adds to it, in one view of a scene."""
    if scene.title == "2dgs":
        *_, splats, boxes, lists = surfel_render.CPU_RENDERER.draw(scene.tensors, 0, view).kept
        return _count_surfels(splats, boxes, lists.tiles, lists.starts, lists.splat_of, view.tile_active.shape[1])
    *_, rows, boxes, lists = voxel_render.CPU_RENDERER.draw(scene.octree, *scene.tensors, 0, view).kept
    pairs = view.tile_octants
    return _count_voxels(
        rows, boxes, view.camera, pairs.tiles, pairs.octants, lists.pairs, lists.starts, lists.voxel_of, view.tile_shape[1]
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _count_surfels(splats, boxes, tiles, starts, splat_of, tiles_x):
    blended = 0
    for tile in tiles:
        left, top = tile % tiles_x * TILE_PX, tile // tiles_x * TILE_PX
        light = np.ones((TILE_PX, TILE_PX))
        for entry in range(starts[tile], starts[tile + 1]):
            s, box = splats[splat_of[entry]], boxes[splat_of[entry]]
            for y in range(max(box[2], top), min(box[3], top + TILE_PX)):
                for x in range(max(box[0], left), min(box[1], left + TILE_PX)):
                    dx, dy = x + 0.5 - s[surfels.CX], y + 0.5 - s[surfels.CY]
                    a = 1.0 + s[surfels.A1] * dx + s[surfels.A2] * dy
                    rho = 2.0 * (dx * dx + dy * dy)
                    if a > 1e-6:
                        u, v = (s[surfels.U1] * dx + s[surfels.U2] * dy) / a, (s[surfels.V1] * dx + s[surfels.V2] * dy) / a
                        rho = min(rho, u * u + v * v)
                    alpha = min(s[surfels.OPACITY] * math.exp(-0.5 * rho), 0.99)
                    if alpha >= ALPHA_MIN and light[y - top, x - left] >= LIGHT_MIN:
                        light[y - top, x - left] *= 1.0 - alpha
                        blended += 1
    return blended


@numba.njit(cache=True, error_model="numpy")
def _count_voxels(rows, boxes, camera, pair_tiles, pair_octants, pairs, starts, voxel_of, tiles_x):
    blended = 0
    for pair in pairs:
        left, top = pair_tiles[pair] % tiles_x * TILE_PX, pair_tiles[pair] // tiles_x * TILE_PX
        thickness = np.zeros((TILE_PX, TILE_PX))
        for entry in range(starts[pair], starts[pair + 1]):
            s, box = rows[voxel_of[entry]], boxes[voxel_of[entry]]
            for y in range(max(box[2], top), min(box[3], top + TILE_PX)):
                for x in range(max(box[0], left), min(box[1], left + TILE_PX)):
                    lit = math.exp(-thickness[y - top, x - left]) >= LIGHT_MIN
                    if not lit or octant_of(camera, x + 0.5, y + 0.5) != pair_octants[pair]:
                        continue
                    first, last, square = s[voxels.TAU_MIN], 1e30, 0.0
                    e, d = np.empty(3), np.empty(3)
                    for axis in range(3):
                        d[axis] = ray_direction(camera, x + 0.5, y + 0.5, axis)
                        square += d[axis] * d[axis]
                        e[axis] = s[voxels.A0 + axis] * (x + 0.5 - s[voxels.X0]) + s[voxels.B0 + axis] * (y + 0.5 - s[voxels.Y0])
                        e[axis] += s[voxels.C0 + axis]
                        first = max(first, -e[axis] / d[axis] - 0.5 / abs(d[axis]))
                        last = min(last, -e[axis] / d[axis] + 0.5 / abs(d[axis]))
                    if last <= first:
                        continue
                    blended += 1
                    u, v, w = e + 0.5 * (first + last) * d
                    p = s[voxels.P1 : voxels.P1 + 8]
                    value = p[0] + p[1] * u + p[2] * v + p[3] * w + p[4] * u * v + p[5] * u * w + p[6] * v * w + p[7] * u * v * w
                    knee = intersection.LINEAR_FROM
                    sigma = value if value > knee else knee * math.exp(value / knee - 1.0)
                    length = (last - first) * s[voxels.SIZE] * math.sqrt(square)
                    thickness[y - top, x - left] += sigma * length * intersection.DENSITY_SCALE
    return blended
