"""Multi-view stereo by PatchMatch: for each pixel of each view, the slanted patch of surface on which the views agree.

Every pixel holds a plane (depth and normal). Planes spread to their neighbours and are refined at random, in a
checkerboard order, and the better one stays (Bleyer et al. 2011; Galliani et al. 2015; Xu and Tao 2019). A plane is
judged by bilaterally weighted normalized cross-correlation with the best of the neighbouring views (Schönberger et al.
2016), and in the second round also by how well it agrees with the depths that those views have found.
"""

import math

import cv2
import numba
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.crops import STRIDE_PX
from zeroshop_steps.runtime.progress import ProgressReport
from zeroshop_steps.surface.patch_cost import (
    BAD,
    DARK,
    DETAIL_PX,
    PATCH_STEPS,
    facing_normal,
    plane_cost,
    random_normal,
    random_number,
    reference_patch,
    world_point,
)
from zeroshop_steps.surface.training_views import TrainingView

NEIGHBOURS = 6
STARTS = 8
"""Random planes tried at first."""
SAME = 1e-3
"""Planes nearer to each other than this, in shares of the search interval and of the cosine, are not compared."""
NO_LIMIT = 2 * BAD
"""For a plane whose cost is wanted however high."""
SPREAD = np.array([(-1, 0), (1, 0), (0, -1), (0, 1), (-5, 0), (5, 0), (0, -5), (0, 5)])
"""Where planes come from, all of the checkerboard's other colour."""


def select_neighbours(cameras: list[Camera], count: int = NEIGHBOURS) -> np.ndarray:
    """(V, count) indices of the views whose directions to the origin are nearest."""
    directions = np.array([camera.centre_in_world for camera in cameras])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    order = np.argsort(-(directions @ directions.T), axis=1, kind="stable")
    return np.ascontiguousarray(order[:, 1 : count + 1])


def estimate_depth_maps(
    views: list[TrainingView], occupied: np.ndarray, half_extent: float, seed: int, photometric_rounds: int = 3, geometric_rounds: int = 2
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    """Depths, normals and costs of every view, at the pixels of its `make_grid_view`.

    Args:
        views: training views in normalized coordinates.
        occupied: (R, R, R) bool visual hull within the cube of +-half_extent; surface is looked for inside it.

    Returns:
        For each view (H, W) float32 depth along the optical axis, 0 outside the mask; (H, W, 3) float32 unit normal in the
        camera's axes; (H, W) float32 cost, 0 the best, 2 the worst.
    """
    cameras = [view.camera for view in views]
    rows = np.array([camera.row for camera in cameras])
    neighbours = select_neighbours(cameras, min(NEIGHBOURS, len(views) - 1))
    sizes = np.array([[c.height_px, c.width_px] for c in cameras])
    height, width = sizes.max(axis=0)
    color = np.zeros((len(views), height, width, 3), np.float32)
    masks = np.zeros((len(views), height, width), np.bool_)
    for i, view in enumerate(views):
        h, w = sizes[i]
        color[i, :h, :w] = cv2.GaussianBlur(np.ascontiguousarray(view.color.numpy().transpose(1, 2, 0)), (0, 0), 0.6)
        # The outermost pixels mix with the background: their edge moves with the view, not with the surface.
        masks[i, :h, :w] = cv2.erode((view.mask.numpy() > 0.5).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    detail = np.stack([_detail(*image) for image in zip(color.mean(axis=3), masks, strict=True)])
    scene = (rows, neighbours, color, detail, masks, sizes)
    grid = (len(views), -(-height // STRIDE_PX), -(-width // STRIDE_PX))
    depth, normal, cost = np.zeros(grid, np.float32), np.zeros((*grid, 3), np.float32), np.full(grid, BAD, np.float32)
    near, far = np.zeros(grid, np.float32), np.zeros(grid, np.float32)
    nothing = (np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32))
    with ProgressReport("stereo", len(views) * (1 + geometric_rounds)) as report:
        for i in range(len(views)):
            _search_interval(rows[i], sizes[i], masks[i], occupied, half_extent, near[i], far[i])
            planes = (near[i], far[i], depth[i], normal[i], cost[i])
            _start(i, *scene, *planes, seed)
            for turn in range(photometric_rounds):
                for parity in (0, 1):
                    _improve(i, *scene, *planes, *nothing, 0.5**turn, parity, _salt(seed, turn))
            report.advance(1)
        for turn in range(geometric_rounds):
            found = (depth.copy(), normal.copy())
            for i in range(len(views)):
                planes = (near[i], far[i], depth[i], normal[i], cost[i])
                _judge_again(i, *scene, *planes, *found)
                for parity in (0, 1):
                    _improve(i, *scene, *planes, *found, 0.1, parity, _salt(seed, 100 + turn))
                report.advance(1)
    crops = [(slice(0, -(-h // STRIDE_PX)), slice(0, -(-w // STRIDE_PX))) for h, w in sizes]
    return tuple([values[i][crop] for i, crop in enumerate(crops)] for values in (depth, normal, cost))


def _detail(luminance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) float32 contrast: luminance less its mean around each pixel, over that mean, of the object alone; 0 outside its mask."""
    inside = mask.astype(np.float32)
    total, weight = (cv2.GaussianBlur(image, (0, 0), DETAIL_PX) for image in (luminance * inside, inside))
    mean = total / np.maximum(weight, 1e-6)
    return inside * (luminance - mean) / (mean + DARK)


def _salt(seed: int, number: int) -> int:
    return (seed * 1000 + number) * 7919 % 2**31


@numba.njit(cache=True, parallel=True)
def _start(index, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, seed):
    """The best of a few random planes at every pixel of the grid."""
    scene = (rows, neighbours, color, detail, masks, sizes)
    row, side = rows[index], 2 * PATCH_STEPS + 1
    no_depth, no_normal = np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32)
    for y in numba.prange(depth.shape[0]):
        patch, weight = np.empty((side, side), np.float32), np.empty((side, side), np.float32)
        places = np.empty((neighbours.shape[1], 7))
        for x in range(depth.shape[1]):
            if far[y, x] <= near[y, x]:
                continue
            py, px = y * STRIDE_PX, x * STRIDE_PX
            dx, dy = (px + 0.5 - row[14]) / row[12], (py + 0.5 - row[15]) / row[13]
            mean, variance = reference_patch(color[index], detail[index], masks[index], py, px, patch, weight)
            for k in range(STARTS):
                pixel, trial = y * 65536 + x, k + 1000 * index
                z = near[y, x] + (far[y, x] - near[y, x]) * (k + random_number(pixel, trial, seed, 1)) / STARTS
                nx, ny, nz = random_normal(dx, dy, random_number(pixel, trial, seed, 2), random_number(pixel, trial, seed, 3))
                limit = cost[y, x] if k else NO_LIMIT
                value = plane_cost(
                    index, scene, no_depth, no_normal, py, px, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, limit
                )
                if value < limit:
                    depth[y, x], cost[y, x] = z, value
                    normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx, ny, nz


@numba.njit(cache=True, parallel=True)
def _judge_again(index, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal):
    """The costs of the planes as they are, by the second round's measure."""
    scene = (rows, neighbours, color, detail, masks, sizes)
    row, side = rows[index], 2 * PATCH_STEPS + 1
    for y in numba.prange(depth.shape[0]):
        patch, weight = np.empty((side, side), np.float32), np.empty((side, side), np.float32)
        places = np.empty((neighbours.shape[1], 7))
        for x in range(depth.shape[1]):
            z = depth[y, x]
            if far[y, x] <= near[y, x]:
                continue
            py, px = y * STRIDE_PX, x * STRIDE_PX
            dx, dy = (px + 0.5 - row[14]) / row[12], (py + 0.5 - row[15]) / row[13]
            mean, variance = reference_patch(color[index], detail[index], masks[index], py, px, patch, weight)
            nx, ny, nz = normal[y, x]
            cost[y, x] = plane_cost(
                index, scene, found_depth, found_normal, py, px, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, NO_LIMIT
            )


@numba.njit(cache=True, parallel=True)
def _improve(
    index, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal, reach, parity, salt
):
    """One half of the checkerboard: take over better planes from the other half, then refine at random within `reach`."""
    scene = (rows, neighbours, color, detail, masks, sizes)
    row, side, spreads = rows[index], 2 * PATCH_STEPS + 1, len(SPREAD)
    height, width = depth.shape
    for y in numba.prange(height):
        patch, weight = np.empty((side, side), np.float32), np.empty((side, side), np.float32)
        places = np.empty((neighbours.shape[1], 7))
        for x in range((y + parity) % 2, width, 2):
            first, last = near[y, x], far[y, x]
            if last <= first:
                continue
            py, px = y * STRIDE_PX, x * STRIDE_PX
            dx, dy = (px + 0.5 - row[14]) / row[12], (py + 0.5 - row[15]) / row[13]
            mean, variance = reference_patch(color[index], detail[index], masks[index], py, px, patch, weight)
            lowest, z, nx, ny, nz = cost[y, x], depth[y, x], normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            for k in range(spreads + 5):
                if k < spreads:
                    j, i = y + SPREAD[k, 0], x + SPREAD[k, 1]
                    if j < 0 or j >= height or i < 0 or i >= width or depth[j, i] <= 0:
                        continue
                    tx, ty, tz = normal[j, i]
                    slope = tx * dx + ty * dy + tz
                    if slope > -0.1:
                        continue
                    ax, ay = (i * STRIDE_PX + 0.5 - row[14]) / row[12], (j * STRIDE_PX + 0.5 - row[15]) / row[13]
                    t = depth[j, i] * (tx * ax + ty * ay + tz) / slope
                else:
                    kind, pixel, trial = k - spreads, y * 65536 + x, k + 1000 * index
                    t, tx, ty, tz = z, nx, ny, nz
                    if kind in (0, 2, 3):
                        t = z + (last - first) * 0.25 * reach * (0.2 if kind == 3 else 1.0) * (2 * random_number(pixel, trial, salt, 4) - 1)
                    if kind in (1, 2):
                        a, b, c = (
                            random_number(pixel, trial, salt, 5),
                            random_number(pixel, trial, salt, 6),
                            random_number(pixel, trial, salt, 7),
                        )
                        turn = 0.8 * reach
                        tx, ty, tz = facing_normal(dx, dy, nx + turn * (a - 0.5), ny + turn * (b - 0.5), nz + turn * (c - 0.5))
                    if kind == 4:
                        t = first + (last - first) * random_number(pixel, trial, salt, 8)
                        tx, ty, tz = random_normal(dx, dy, random_number(pixel, trial, salt, 9), random_number(pixel, trial, salt, 10))
                same = abs(t - z) < SAME * (last - first) and tx * nx + ty * ny + tz * nz > 1 - SAME
                if t < first or t > last or same:
                    continue
                value = plane_cost(
                    index, scene, found_depth, found_normal, py, px, patch, weight, mean, variance, places, dx, dy, t, tx, ty, tz, lowest
                )
                if value < lowest:
                    lowest, z, nx, ny, nz = value, t, tx, ty, tz
            cost[y, x], depth[y, x] = lowest, z
            normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx, ny, nz


@numba.njit(cache=True, parallel=True)
def _search_interval(row, size, mask, occupied, half, near, far):
    """First and last depth at which each pixel's ray is inside the voxel hull, widened by a voxel; both 0 where it misses."""
    resolution = occupied.shape[0]
    step = half / resolution
    cx, cy, cz = world_point(row, 0.0, 0.0, 0.0)
    distance = math.sqrt(cx * cx + cy * cy + cz * cz)
    for y in numba.prange(-(-size[0] // STRIDE_PX)):
        for x in range(-(-size[1] // STRIDE_PX)):
            py, px = y * STRIDE_PX, x * STRIDE_PX
            if not mask[py, px]:
                continue
            wx, wy, wz = world_point(row, (px + 0.5 - row[14]) / row[12], (py + 0.5 - row[15]) / row[13], 1.0)
            rx, ry, rz = wx - cx, wy - cy, wz - cz
            length = math.sqrt(rx * rx + ry * ry + rz * rz)
            z = max((distance - 1.8 * half) / length, 1e-3)
            end = (distance + 1.8 * half) / length
            found = False
            while z < end:
                i, j, k = (
                    int((cx + z * rx + half) / (2 * step)),
                    int((cy + z * ry + half) / (2 * step)),
                    int((cz + z * rz + half) / (2 * step)),
                )
                if 0 <= i < resolution and 0 <= j < resolution and 0 <= k < resolution and occupied[i, j, k]:
                    if not found:
                        near[y, x] = z - 2 * step
                    found = True
                    far[y, x] = z + 2 * step
                z += step / length
