"""Multi-view stereo by PatchMatch: for each pixel of each view, the slanted patch of surface on which the views agree best.

Every pixel holds a plane (depth and normal). In checkerboard order, planes propagate to their neighbours and are refined at
random, and the better plane stays (Bleyer et al. 2011; Galliani et al. 2015; Xu and Tao 2019). The cost of a plane is a
bilaterally weighted normalized cross-correlation with the best of the neighbouring views (Schönberger et al. 2016). In the
geometric rounds it also counts how well the plane agrees with the depths that those views have found.
"""

import math

import cv2
import numba
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.crops import STRIDE_PX
from zeroshop_steps.runtime.progress import ProgressReport
from zeroshop_steps.surface.patch_cost import (
    COST_MAX,
    CX,
    CY,
    DARK,
    DETAIL_PX,
    FX,
    FY,
    PATCH_STEPS,
    facing_normal,
    fill_reference_patch,
    plane_cost,
    random_normal,
    random_number,
    unproject_ray,
)
from zeroshop_steps.surface.training_views import TrainingView

NEIGHBOURS = 6
"""Views that each view is compared with."""
INITIAL_PLANES = 8
"""Random planes tried at each pixel before the first round, one in each eighth of its depth interval."""
SAME_PLANE = 1e-3
"""Planes that differ by less than this, as a share of the depth interval and in the cosine, are not compared again."""
NO_LIMIT = 2 * COST_MAX
"""For a plane whose cost is wanted however high it is."""
PROPAGATION = np.array([(-1, 0), (1, 0), (0, -1), (0, 1), (-5, 0), (5, 0), (0, -5), (0, 5)])
"""Rows and columns from which planes are taken over; all are of the checkerboard's other colour."""
BLUR_PX = 0.6
"""Standard deviation of a blur that makes the colours smooth enough to be interpolated."""
MASK_EROSION_PX = 5
"""Edge of the square by which masks are eroded. The outermost pixels mix with the background: their edge moves with the view, not with
the surface."""
GEOMETRIC_REACH = 0.1
"""Reach of the random refinement in the geometric rounds; in the photometric ones it is 1, 1/2, 1/4."""
REFINED_DEPTH, REFINED_FINE, REFINED_NORMAL = 0.25, 0.2, 0.8
"""Refinement at reach 1 changes the depth by up to the first, as a share of its interval, and the normal's coordinates by up to
half of the third; a fine trial changes the depth by the second as much."""
TRIALS = 5
"""Random planes tried at each pixel in each round."""
SLOPE_MIN = 0.1
"""A neighbour's plane that is seen at a lower cosine, times the ray's length, is not taken over."""
SEARCH_RADIUS = 1.8
"""Depths are searched within this many half extents of the hull's cube around its centre: its corners lie at 1.73."""


def select_neighbours(cameras: list[Camera], count: int = NEIGHBOURS) -> np.ndarray:
    """(V, count) indices of the views whose directions, seen from the object, are nearest to each view's own."""
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
        occupied: (R, R, R) bool visual hull within the cube of +-half_extent, inside which surface is searched.
        seed: of the random planes.
        photometric_rounds, geometric_rounds: rounds of propagation and refinement without and with the other views' depths.

    Returns:
        For each view (H, W) float32 depth along the optical axis, 0 outside the mask; (H, W, 3) float32 unit normal in the
        camera's axes; (H, W) float32 cost, 0 the best, 2 the worst.
    """
    rows = np.array([view.camera.row for view in views])
    neighbours = select_neighbours([view.camera for view in views], min(NEIGHBOURS, len(views) - 1))
    sizes = np.array([[view.camera.height_px, view.camera.width_px] for view in views])
    height, width = sizes.max(axis=0)
    scene = (rows, neighbours, *_stack_images(views, height, width), sizes)
    masks = scene[4]
    grid = (len(views), -(-height // STRIDE_PX), -(-width // STRIDE_PX))
    depth, normal, cost = np.zeros(grid, np.float32), np.zeros((*grid, 3), np.float32), np.full(grid, COST_MAX, np.float32)
    near, far = np.zeros(grid, np.float32), np.zeros(grid, np.float32)
    nothing = (np.zeros((1, 1, 1), np.float32), np.zeros((1, 1, 1, 3), np.float32))
    with ProgressReport("stereo", len(views) * (1 + geometric_rounds)) as report:
        for i in range(len(views)):
            _find_depth_interval(rows[i], sizes[i], masks[i], occupied, half_extent, near[i], far[i])
            planes = (near[i], far[i], depth[i], normal[i], cost[i])
            _initialize_planes(i, *scene, *planes, seed)
            for number in range(photometric_rounds):
                for parity in (0, 1):
                    _propagate_and_refine(i, *scene, *planes, *nothing, 0.5**number, parity, _mix_seed(seed, number))
            report.advance(1)
        for number in range(geometric_rounds):
            found = (depth.copy(), normal.copy())
            for i in range(len(views)):
                planes = (near[i], far[i], depth[i], normal[i], cost[i])
                _recompute_costs(i, *scene, *planes, *found)
                for parity in (0, 1):
                    _propagate_and_refine(i, *scene, *planes, *found, GEOMETRIC_REACH, parity, _mix_seed(seed, 100 + number))
                report.advance(1)
    crops = [(slice(0, -(-h // STRIDE_PX)), slice(0, -(-w // STRIDE_PX))) for h, w in sizes]
    depths, normals, costs = ([values[i][crop] for i, crop in enumerate(crops)] for values in (depth, normal, cost))
    return depths, normals, costs


def _stack_images(views: list[TrainingView], height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blurred colours (V, H, W, 3), local contrast (V, H, W) and eroded masks (V, H, W) of all views, in one corner of equal images."""
    color = np.zeros((len(views), height, width, 3), np.float32)
    masks = np.zeros((len(views), height, width), np.bool_)
    square = np.ones((MASK_EROSION_PX, MASK_EROSION_PX), np.uint8)
    for i, view in enumerate(views):
        h, w = view.camera.height_px, view.camera.width_px
        color[i, :h, :w] = cv2.GaussianBlur(np.ascontiguousarray(view.color.numpy().transpose(1, 2, 0)), (0, 0), BLUR_PX)
        masks[i, :h, :w] = cv2.erode((view.mask.numpy() > 0.5).astype(np.uint8), square) > 0
    detail = np.stack([_local_contrast(*image) for image in zip(color.mean(axis=3), masks, strict=True)])
    return color, detail, masks


def _local_contrast(luminance: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(H, W) float32: by how much, as a share, a pixel's luminance exceeds the mean around it. Of the object alone, 0 outside its mask."""
    inside = mask.astype(np.float32)
    total, weight = (cv2.GaussianBlur(image, (0, 0), DETAIL_PX) for image in (luminance * inside, inside))
    mean = total / np.maximum(weight, 1e-6)
    return inside * (luminance - mean) / (mean + DARK)


def _mix_seed(seed: int, number: int) -> int:
    """A seed of its own for each round."""
    return (seed * 1000 + number) * 7919 % 2**31


@numba.njit(cache=True, parallel=True)
def _initialize_planes(index, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, seed):
    """Start with the best of a few random planes at every pixel of the grid."""
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
            dx, dy = (px + 0.5 - row[CX]) / row[FX], (py + 0.5 - row[CY]) / row[FY]
            mean, variance = fill_reference_patch(color[index], detail[index], masks[index], py, px, patch, weight)
            for k in range(INITIAL_PLANES):
                pixel, trial = y * 65536 + x, k + 1000 * index
                z = near[y, x] + (far[y, x] - near[y, x]) * (k + random_number(pixel, trial, seed, 1)) / INITIAL_PLANES
                nx, ny, nz = random_normal(dx, dy, random_number(pixel, trial, seed, 2), random_number(pixel, trial, seed, 3))
                limit = cost[y, x] if k else NO_LIMIT
                value = plane_cost(
                    index, scene, no_depth, no_normal, py, px, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, limit
                )
                if value < limit:
                    depth[y, x], cost[y, x] = z, value
                    normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx, ny, nz


@numba.njit(cache=True, parallel=True)
def _recompute_costs(index, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal):
    """Compute the costs of the planes again, with the depths that the other views have found."""
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
            dx, dy = (px + 0.5 - row[CX]) / row[FX], (py + 0.5 - row[CY]) / row[FY]
            mean, variance = fill_reference_patch(color[index], detail[index], masks[index], py, px, patch, weight)
            nx, ny, nz = normal[y, x]
            cost[y, x] = plane_cost(
                index, scene, found_depth, found_normal, py, px, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, NO_LIMIT
            )


@numba.njit(cache=True, parallel=True)
def _propagate_and_refine(
    index, rows, neighbours, color, detail, masks, sizes, near, far, depth, normal, cost, found_depth, found_normal, reach, parity, salt
):
    """For one half of the checkerboard, take over better planes from the other half, then refine them at random within `reach`."""
    scene = (rows, neighbours, color, detail, masks, sizes)
    row, side, spreads = rows[index], 2 * PATCH_STEPS + 1, len(PROPAGATION)
    height, width = depth.shape
    for y in numba.prange(height):
        patch, weight = np.empty((side, side), np.float32), np.empty((side, side), np.float32)
        places = np.empty((neighbours.shape[1], 7))
        for x in range((y + parity) % 2, width, 2):
            first, last = near[y, x], far[y, x]
            if last <= first:
                continue
            py, px = y * STRIDE_PX, x * STRIDE_PX
            dx, dy = (px + 0.5 - row[CX]) / row[FX], (py + 0.5 - row[CY]) / row[FY]
            mean, variance = fill_reference_patch(color[index], detail[index], masks[index], py, px, patch, weight)
            lowest, z, nx, ny, nz = cost[y, x], depth[y, x], normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
            for k in range(spreads + TRIALS):
                if k < spreads:
                    j, i = y + PROPAGATION[k, 0], x + PROPAGATION[k, 1]
                    if j < 0 or j >= height or i < 0 or i >= width or depth[j, i] <= 0:
                        continue
                    tx, ty, tz = normal[j, i]
                    slope = tx * dx + ty * dy + tz
                    if slope > -SLOPE_MIN:
                        continue
                    ax, ay = (i * STRIDE_PX + 0.5 - row[CX]) / row[FX], (j * STRIDE_PX + 0.5 - row[CY]) / row[FY]
                    t = depth[j, i] * (tx * ax + ty * ay + tz) / slope
                else:
                    # Kinds of trials: 0 another depth, 1 another normal, 2 both, 3 a depth nearby, 4 any plane.
                    kind, pixel, trial = k - spreads, y * 65536 + x, k + 1000 * index
                    t, tx, ty, tz = z, nx, ny, nz
                    if kind in (0, 2, 3):
                        fine = REFINED_FINE if kind == 3 else 1.0
                        t = z + (last - first) * REFINED_DEPTH * reach * fine * (2 * random_number(pixel, trial, salt, 4) - 1)
                    if kind in (1, 2):
                        a, b, c = (
                            random_number(pixel, trial, salt, 5),
                            random_number(pixel, trial, salt, 6),
                            random_number(pixel, trial, salt, 7),
                        )
                        tilt = REFINED_NORMAL * reach
                        tx, ty, tz = facing_normal(dx, dy, nx + tilt * (a - 0.5), ny + tilt * (b - 0.5), nz + tilt * (c - 0.5))
                    if kind == 4:
                        t = first + (last - first) * random_number(pixel, trial, salt, 8)
                        tx, ty, tz = random_normal(dx, dy, random_number(pixel, trial, salt, 9), random_number(pixel, trial, salt, 10))
                same = abs(t - z) < SAME_PLANE * (last - first) and tx * nx + ty * ny + tz * nz > 1 - SAME_PLANE
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
def _find_depth_interval(row, size, mask, occupied, half, near, far):
    """Find the first and last depth at which each pixel's ray is inside the hull, widened by a voxel; both 0 where it misses it."""
    resolution = occupied.shape[0]
    step = half / resolution
    cx, cy, cz = unproject_ray(row, 0.0, 0.0, 0.0)
    distance = math.sqrt(cx * cx + cy * cy + cz * cz)
    for y in numba.prange(-(-size[0] // STRIDE_PX)):
        for x in range(-(-size[1] // STRIDE_PX)):
            py, px = y * STRIDE_PX, x * STRIDE_PX
            if not mask[py, px]:
                continue
            wx, wy, wz = unproject_ray(row, (px + 0.5 - row[CX]) / row[FX], (py + 0.5 - row[CY]) / row[FY], 1.0)
            rx, ry, rz = wx - cx, wy - cy, wz - cz
            length = math.sqrt(rx * rx + ry * ry + rz * rz)
            z = max((distance - SEARCH_RADIUS * half) / length, 1e-3)
            end = (distance + SEARCH_RADIUS * half) / length
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
