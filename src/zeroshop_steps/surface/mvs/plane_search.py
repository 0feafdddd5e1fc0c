"""PatchMatch at one pixel: planes are tried at random, taken over from other pixels, and refined. Kernels of the stereo.

The CPU (cpu_patchmatch.py) and CUDA (cuda_patchmatch.py) compile the same functions; patch_cost.py says in which precision. What a pixel
of one colour of the checkerboard tries depends on its own plane, on those of the other colour, and on random numbers that are a function
of the pixel. So the result is the same in whatever order the pixels of one colour are visited.

Arguments of all of them:
    index, scene: the view, and all of them, as in `patch_cost.plane_cost`.
    planes: of the view's grid, all float32: first and last depth (H, W), 0 where there is none; and of the best plane so far, depth (H, W),
        normal (H, W, 3) and cost (H, W). Only the plane at (x, y) is changed.
    found: depth (V, H, W) and normal (V, H, W, 3) of the planes of all views; of length 1 until there are any.
    y, x: the pixel of the grid.
    space: patch, weight and places, working space for `fill_reference_patch` and `plane_cost`.
"""

import numba
import numpy as np

from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX
from zeroshop_steps.surface.mvs.patch_cost import (
    COST_MAX,
    CX,
    CY,
    FX,
    FY,
    facing_normal,
    fill_reference_patch,
    plane_cost,
    random_normal,
    random_number,
)

INITIAL_PLANES = 8
"""Random planes tried at each pixel before the first round, one in each eighth of its depth interval."""
SAME_PLANE = 1e-3
"""Planes that differ by less than this, as a share of the depth interval and in the cosine, are not compared again."""
NO_LIMIT = 2 * COST_MAX
"""For a plane whose cost is wanted however high it is."""
PROPAGATION = np.array([(-1, 0), (1, 0), (0, -1), (0, 1), (-5, 0), (5, 0), (0, -5), (0, 5)])
"""Rows and columns from which planes are taken over; all are of the checkerboard's other colour."""
REFINED_DEPTH, REFINED_FINE, REFINED_NORMAL = 0.25, 0.2, 0.8
"""Refinement at reach 1 changes the depth by up to the first, as a share of its interval, and the normal's coordinates by up to
half of the third; a fine trial changes the depth by the second as much."""
TRIALS = 5
"""Random planes tried at each pixel in each round."""
SLOPE_MIN = 0.1
"""A neighbour's plane that is seen at a lower cosine, times the ray's length, is not taken over."""
FIRST_DEPTH, FIRST_SLANT, FIRST_TURN, OTHER_DEPTH, TILT_X, TILT_Y, TILT_Z = map(np.uint64, range(1, 8))
ANY_DEPTH, ANY_SLANT, ANY_TURN = map(np.uint64, range(8, 11))
"""Which random number of a trial it is. Of integers of Python, Numba would compile `random_number` for each."""


@numba.njit(cache=True, forceinline=True)
def ray_slopes(row, y, x):
    """Slopes of the ray through a pixel of the grid."""
    real = type(row[0])
    half = real(0.5)
    return (real(x * STRIDE_PX) + half - row[CX]) / row[FX], (real(y * STRIDE_PX) + half - row[CY]) / row[FY]


@numba.njit(cache=True, forceinline=True)
def initialize_plane(index, scene, planes, found, seed, y, x, space):
    """Start with the best of a few random planes."""
    near, far, depth, normal, cost = planes
    found_depth, found_normal = found
    patch, weight, places = space
    row = scene[0][index]
    real = type(row[0])
    dx, dy = ray_slopes(row, y, x)
    py, px = y * STRIDE_PX, x * STRIDE_PX
    mean, variance = fill_reference_patch(index, scene, py, px, patch, weight)
    for k in range(INITIAL_PLANES):
        pixel, trial = y * 65536 + x, k + 1000 * index
        a, b, c = (
            real(random_number(pixel, trial, seed, FIRST_DEPTH)),
            real(random_number(pixel, trial, seed, FIRST_SLANT)),
            real(random_number(pixel, trial, seed, FIRST_TURN)),
        )
        z = near[y, x] + (far[y, x] - near[y, x]) * (real(k) + a) / real(INITIAL_PLANES)
        nx, ny, nz = random_normal(dx, dy, b, c)
        limit = real(cost[y, x]) if k else real(NO_LIMIT)
        value = plane_cost(
            index, scene, found_depth, found_normal, py, px, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, limit
        )
        if value < limit:
            depth[y, x], cost[y, x] = z, value
            normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx, ny, nz


@numba.njit(cache=True, forceinline=True)
def recompute_cost(index, scene, planes, found, y, x, space):
    """Compute the cost of the plane again, with the depths that the other views have found."""
    _, _, depth, normal, cost = planes
    found_depth, found_normal = found
    patch, weight, places = space
    row = scene[0][index]
    real = type(row[0])
    dx, dy = ray_slopes(row, y, x)
    py, px = y * STRIDE_PX, x * STRIDE_PX
    mean, variance = fill_reference_patch(index, scene, py, px, patch, weight)
    z, nx, ny, nz = real(depth[y, x]), real(normal[y, x, 0]), real(normal[y, x, 1]), real(normal[y, x, 2])
    cost[y, x] = plane_cost(
        index, scene, found_depth, found_normal, py, px, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, real(NO_LIMIT)
    )


@numba.njit(cache=True, forceinline=True)
def propagate_and_refine(index, scene, planes, found, reach, salt, y, x, space):
    """Take over a better plane from the checkerboard's other colour, then refine it at random within `reach`."""
    near, far, depth, normal, cost = planes
    found_depth, found_normal = found
    patch, weight, places = space
    row, spreads = scene[0][index], len(PROPAGATION)
    real = type(row[0])
    height, width = depth.shape
    first, last = near[y, x], far[y, x]
    dx, dy = ray_slopes(row, y, x)
    py, px = y * STRIDE_PX, x * STRIDE_PX
    mean, variance = fill_reference_patch(index, scene, py, px, patch, weight)
    lowest, z, nx, ny, nz = real(cost[y, x]), real(depth[y, x]), real(normal[y, x, 0]), real(normal[y, x, 1]), real(normal[y, x, 2])
    for k in range(spreads + TRIALS):
        if k < spreads:
            j, i = y + PROPAGATION[k, 0], x + PROPAGATION[k, 1]
            if j < 0 or j >= height or i < 0 or i >= width or depth[j, i] <= real(0):
                continue
            tx, ty, tz = real(normal[j, i, 0]), real(normal[j, i, 1]), real(normal[j, i, 2])
            slope = tx * dx + ty * dy + tz
            if slope > real(-SLOPE_MIN):
                continue
            ax, ay = ray_slopes(row, j, i)
            t = depth[j, i] * (tx * ax + ty * ay + tz) / slope
        else:
            # Kinds of trials: 0 another depth, 1 another normal, 2 both, 3 a depth nearby, 4 any plane.
            kind, pixel, trial = k - spreads, y * 65536 + x, k + 1000 * index
            t, tx, ty, tz = z, nx, ny, nz
            if kind in (0, 2, 3):
                change = real(2) * real(random_number(pixel, trial, salt, OTHER_DEPTH)) - real(1)
                fine = real(REFINED_FINE) if kind == 3 else real(1)
                t = z + (last - first) * real(REFINED_DEPTH) * reach * fine * change
            if kind in (1, 2):
                half, tilt = real(0.5), real(REFINED_NORMAL) * reach
                a, b, c = (
                    real(random_number(pixel, trial, salt, TILT_X)),
                    real(random_number(pixel, trial, salt, TILT_Y)),
                    real(random_number(pixel, trial, salt, TILT_Z)),
                )
                tx, ty, tz = facing_normal(dx, dy, nx + tilt * (a - half), ny + tilt * (b - half), nz + tilt * (c - half))
            if kind == 4:
                a, b, c = (
                    real(random_number(pixel, trial, salt, ANY_DEPTH)),
                    real(random_number(pixel, trial, salt, ANY_SLANT)),
                    real(random_number(pixel, trial, salt, ANY_TURN)),
                )
                t = first + (last - first) * a
                tx, ty, tz = random_normal(dx, dy, b, c)
        same = abs(t - z) < real(SAME_PLANE) * (last - first) and tx * nx + ty * ny + tz * nz > real(1 - SAME_PLANE)
        if t < first or t > last or same:
            continue
        value = plane_cost(
            index, scene, found_depth, found_normal, py, px, patch, weight, mean, variance, places, dx, dy, t, tx, ty, tz, lowest
        )
        if value < lowest:
            lowest, z, nx, ny, nz = value, t, tx, ty, tz
    cost[y, x], depth[y, x] = lowest, z
    normal[y, x, 0], normal[y, x, 1], normal[y, x, 2] = nx, ny, nz
