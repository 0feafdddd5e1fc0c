"""What a slanted patch of surface costs: how well the views that see it agree. Kernels of the stereo.

A camera is a row of 16 numbers (`Camera.row`): rotation and translation of camera_from_world, then the intrinsics. A ray is
given by its slopes dx = x / z and dy = y / z in the camera's frame, a plane by its depth z on that ray and its unit normal.
The costs and their bounds were set by hand.

The CPU and CUDA compile the same functions. Both calculate in the precision of the cameras' rows, which is double on the CPU and single
on CUDA: `real` is its type, and constants are made of it, since a literal would make everything double.
"""

import math

import numba
import numpy as np

from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX
from zeroshop_steps.geometry.observation.visibility import EDGE_ON_COSINE

FX, FY, CX, CY = 12, 13, 14, 15
"""Where a camera's row holds its intrinsics, in pixels."""
NEIGHBOURS = 6
"""Views that each view is compared with, at most."""
PATCH_STEPS = 3
PATCH_SPACING_PX = 3
"""A patch is sampled at (2 * 3 + 1)^2 points, three pixels apart."""
PATCH_SIDE = 2 * PATCH_STEPS + 1
PLACE_WIDTH = 7
"""Numbers that `plane_cost` keeps of each neighbouring view."""
DETAIL_PX = 4.0
"""Standard deviation of the blur that is subtracted: smooth shading looks alike everywhere and would agree with anything."""
NOISE = 0.02
"""Contrast of noise, highlights and shading on plain parts. Its square is added to the variances, so that it counts as nothing."""
DARK = 0.03
"""Luminance added to the mean that contrast refers to: near black there is only sensor noise."""
SIMILAR_LUMINANCE = 0.06
"""Standard deviation of the bilateral weights."""
COLOR_WEIGHT = 3.0
"""Cost of a mean difference of one between two colours in [0, 1]."""
COLOR_DIFFERENCE_MAX = 0.1
"""Larger differences cost no more: they come from highlights and shadows."""
GEOMETRIC_WEIGHT = 0.2
"""Cost of a pixel of distance between a plane and the depths of another view."""
GEOMETRIC_ERROR_MAX_PX = 3.0
"""Larger distances cost no more, as in COLMAP."""
COST_MAX = 2.0
"""The cost of a plane that no view confirms."""
CORRELATED = 1e9
"""The bound of a view that has been correlated: it is not looked at again."""
ROUNDING = 1e-5
"""By how much a correlation may exceed one through rounding."""
NORMAL_SLANT_MAX = 3.0
"""Random normals lie within the angle of this tangent, about 72 degrees, of the direction to the camera."""
COSINE_MIN, COSINE_BENT = 0.2, 0.25
"""Where the cosine between normal and viewing ray is below the first, it is clamped to the second."""
GRAZING = 1e-6
"""A ray that meets a plane at a lower slope does not meet it."""


@numba.njit(cache=True, forceinline=True)
def random_number(a, b, c, d):
    """A number in [0, 1) that depends on four integers only, not on the thread (xorshift-multiply mixing)."""
    x = np.uint64(a) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(b) * np.uint64(0xC2B2AE3D27D4EB4F)
    x += np.uint64(c) * np.uint64(0x165667B19E3779F9) + np.uint64(d) * np.uint64(0x27D4EB2F165667C5)
    x ^= x >> np.uint64(30)
    x *= np.uint64(0xBF58476D1CE4E5B9)
    x ^= x >> np.uint64(27)
    x *= np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return float(x >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, forceinline=True)
def project_point(row, x, y, z):
    """Position in pixels, counted from the centre of the first one, and depth of a point in the world."""
    half = type(x)(0.5)
    px = row[0] * x + row[1] * y + row[2] * z + row[9]
    py = row[3] * x + row[4] * y + row[5] * z + row[10]
    pz = row[6] * x + row[7] * y + row[8] * z + row[11]
    return row[FX] * px / pz + row[CX] - half, row[FY] * py / pz + row[CY] - half, pz


@numba.njit(cache=True, forceinline=True)
def unproject_ray(row, dx, dy, z):
    """The point in the world at depth z on the ray of slopes dx and dy."""
    a, b, c = z * dx - row[9], z * dy - row[10], z - row[11]
    return row[0] * a + row[3] * b + row[6] * c, row[1] * a + row[4] * b + row[7] * c, row[2] * a + row[5] * b + row[8] * c


@numba.njit(cache=True, forceinline=True)
def random_normal(dx, dy, a, b):
    """A unit normal that faces the camera, from two random numbers in [0, 1)."""
    real = type(dx)
    slant, turn = math.sqrt(a) * real(NORMAL_SLANT_MAX), real(2 * math.pi) * b
    return facing_normal(dx, dy, -dx + slant * math.cos(turn), -dy + slant * math.sin(turn), real(-1))


@numba.njit(cache=True, forceinline=True)
def facing_normal(dx, dy, nx, ny, nz):
    """The unit normal along (nx, ny, nz), bent towards the camera where it looks away or grazes."""
    real = type(dx)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    ray = math.sqrt(dx * dx + dy * dy + real(1))
    cosine = -(nx * dx + ny * dy + nz) / ray
    if cosine < real(COSINE_MIN):
        lack = (real(COSINE_BENT) - cosine) / ray
        nx, ny, nz = nx - lack * dx, ny - lack * dy, nz - lack
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / length, ny / length, nz / length
    return nx, ny, nz


@numba.njit(cache=True, forceinline=True)
def fill_reference_patch(index, scene, y, x, patch, weight):
    """Fill patch and weight, both (side, side): the detail around pixel (x, y), and normalized bilateral weights of the luminance.

    Args:
        index, scene: the view, and all of them, as in `plane_cost`.

    Returns the weighted mean and variance.
    """
    rows, _, colors, details, masks, _ = scene
    color, detail, mask = colors[index], details[index], masks[index]
    real = type(rows[index, 0])
    height, width = mask.shape
    total = mean = square = real(0)
    for j in range(PATCH_SIDE):
        for i in range(PATCH_SIDE):
            v = min(max(y + (j - PATCH_STEPS) * PATCH_SPACING_PX, 0), height - 1)
            u = min(max(x + (i - PATCH_STEPS) * PATCH_SPACING_PX, 0), width - 1)
            value, difference = detail[v, u], real(0)
            for c in range(3):
                difference += (color[v, u, c] - color[y, x, c]) / real(3 * SIMILAR_LUMINANCE)
            w = math.exp(real(-0.5) * difference * difference) if mask[v, u] else real(0)
            patch[j, i], weight[j, i] = value, w
            total += w
            mean += w * value
            square += w * value * value
    for j in range(PATCH_SIDE):
        for i in range(PATCH_SIDE):
            weight[j, i] /= total
    mean /= total
    return mean, max(square / total - mean * mean, real(0))


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _project_patch(row, other, size, dx, dy, z, nx, ny, nz, place):
    """Fill `place` with where a plane's patch projects to in another view: its centre (u, v), and by how much (u, v) changes for one
    pixel along x and one along y.

    Returns False where the view does not see the whole patch.
    """
    real = type(dx)
    offset = z * (nx * dx + ny * dy + nz)
    ex, ey = dx + real(1) / row[FX], dy + real(1) / row[FY]
    wx, wy, wz = unproject_ray(row, dx, dy, z)
    u0, v0, pz = project_point(other, wx, wy, wz)
    below_x, below_y = nx * ex + ny * dy + nz, nx * dx + ny * ey + nz
    if pz <= real(0) or below_x >= real(-GRAZING) or below_y >= real(-GRAZING):
        return False
    wx, wy, wz = unproject_ray(row, ex, dy, offset / below_x)
    ux, vx, _ = project_point(other, wx, wy, wz)
    wx, wy, wz = unproject_ray(row, dx, ey, offset / below_y)
    uy, vy, _ = project_point(other, wx, wy, wz)
    dux, dvx, duy, dvy = ux - u0, vx - v0, uy - u0, vy - v0
    place[0], place[1], place[2], place[3], place[4], place[5] = u0, v0, dux, dvx, duy, dvy
    reach = real(PATCH_STEPS * PATCH_SPACING_PX)
    reach_u, reach_v = reach * (abs(dux) + abs(duy)), reach * (abs(dvx) + abs(dvy))
    first, last_u, last_v = real(0), real(size[1] - 1), real(size[0] - 1)
    return u0 - reach_u >= first and v0 - reach_v >= first and u0 + reach_u < last_u and v0 + reach_v < last_v


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _correlation_cost(place, detail, patch, weight, mean, variance):
    """(1 - c) / 2, where c is the correlation of a patch with the image of another view where it projects to: 0 to 1."""
    u0, v0, dux, dvx, duy, dvy = place[0], place[1], place[2], place[3], place[4], place[5]
    real = type(u0)
    sum_b = sum_bb = sum_ab = np.float32(0.0)
    for j in range(PATCH_SIDE):
        t = real((j - PATCH_STEPS) * PATCH_SPACING_PX)
        for i in range(PATCH_SIDE):
            s = real((i - PATCH_STEPS) * PATCH_SPACING_PX)
            u, v = u0 + s * dux + t * duy, v0 + s * dvx + t * dvy
            x, y = int(u), int(v)
            fx, fy = np.float32(u - real(x)), np.float32(v - real(y))
            top = detail[y, x] + (detail[y, x + 1] - detail[y, x]) * fx
            bottom = detail[y + 1, x] + (detail[y + 1, x + 1] - detail[y + 1, x]) * fx
            b = top + (bottom - top) * fy
            w = weight[j, i]
            sum_b += w * b
            sum_bb += w * b * b
            sum_ab += w * b * patch[j, i]
    covariance = sum_ab - sum_b * mean
    noise = real(NOISE**2)
    spread = math.sqrt((variance + noise) * (max(sum_bb - sum_b * sum_b, np.float32(0.0)) + noise))
    return real(0.5) * (real(1) - covariance / spread)


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _color_cost(color, index, y, x, other, u, v):
    """The cost of the difference between a pixel's colour and that at (u, v) in another view."""
    real = type(u)
    j, i = int(v + real(0.5)), int(u + real(0.5))
    difference = real(0)
    for c in range(3):
        difference += abs(color[index, y, x, c] - color[other, j, i, c]) / real(3)
    return real(COLOR_WEIGHT) * min(difference, real(COLOR_DIFFERENCE_MAX))


@numba.njit(cache=True, forceinline=True, fastmath=True)
def _depth_cost(row, other, depth, normal, y, x, u, v):
    """The cost of the distance in pixels between (x, y) and the projection of the surface that the other view has found at (u, v)."""
    real = type(u)
    half, stride = real(0.5), real(STRIDE_PX)
    error = real(GEOMETRIC_ERROR_MAX_PX)
    gy, gx = int(v / stride + half), int(u / stride + half)
    if gy < depth.shape[0] and gx < depth.shape[1] and depth[gy, gx] > real(0):
        # Where the plane that the other view has found there meets that view's ray through (u, v).
        nx, ny, nz = normal[gy, gx, 0], normal[gy, gx, 1], normal[gy, gx, 2]
        dx, dy = (u + half - other[CX]) / other[FX], (v + half - other[CY]) / other[FY]
        ahead = nx * dx + ny * dy + nz
        if ahead < real(-EDGE_ON_COSINE):
            px, py = (real(gx * STRIDE_PX) + half - other[CX]) / other[FX], (real(gy * STRIDE_PX) + half - other[CY]) / other[FY]
            wx, wy, wz = unproject_ray(other, dx, dy, depth[gy, gx] * (nx * px + ny * py + nz) / ahead)
            back_u, back_v, _ = project_point(row, wx, wy, wz)
            across, down = back_u - real(x), back_v - real(y)
            error = min(math.sqrt(across * across + down * down), error)
    return real(GEOMETRIC_WEIGHT) * error


@numba.njit(cache=True, forceinline=True, fastmath=True)
def plane_cost(index, scene, found_depth, found_normal, y, x, patch, weight, mean, variance, places, dx, dy, z, nx, ny, nz, limit):
    """The mean cost of a plane over its two best neighbouring views (some are occluded), or COST_MAX where that is not below `limit`.

    Colours and the other views' depths are cheap to compare, and bound a view's cost from below, since a correlation only adds
    to it. The views are correlated in the order of their bounds, until no other view can change the result.

    Args:
        index: the reference view.
        scene: rows, neighbours (V, count) to compare each view with, color, detail, masks and sizes of all views, as in
            `patchmatch.estimate_depth_maps`.
        found_depth, found_normal: planes of the other views at the pixels of their grids; of length 1 in the first round.
        y, x, patch, weight, mean, variance: the pixel, and what `fill_reference_patch` gave for it.
        places: (count, PLACE_WIDTH) working space.
        dx, dy, z, nx, ny, nz: the plane.
    """
    rows, neighbours, color, detail, _, sizes = scene
    real = type(dx)
    cost_max, rounding = real(COST_MAX), real(ROUNDING)
    row, count = rows[index], neighbours.shape[1]
    for k in range(count):
        n = neighbours[index, k]
        bound = cost_max
        if _project_patch(row, rows[n], sizes[n], dx, dy, z, nx, ny, nz, places[k]):
            bound = _color_cost(color, index, y, x, n, places[k, 0], places[k, 1])
            if found_depth.shape[0] > 1:
                bound += _depth_cost(row, rows[n], found_depth[n], found_normal[n], y, x, places[k, 0], places[k, 1])
        places[k, 6] = bound
    first = second = cost_max
    for _ in range(count):
        nearest, next_bound = 0, cost_max
        for i in range(1, count):
            if places[i, 6] < places[nearest, 6]:
                nearest, next_bound = i, places[nearest, 6]
            elif places[i, 6] < next_bound:
                next_bound = places[i, 6]
        bound = places[nearest, 6]
        if bound - rounding >= second:
            break
        if count > 1 and bound + min(first, next_bound) - rounding >= real(2) * limit and first + second >= real(2) * limit:
            return cost_max
        if bound < cost_max:
            n = neighbours[index, nearest]
            cost = min(bound + _correlation_cost(places[nearest], detail[n], patch, weight, mean, variance), cost_max)
            if cost < first:
                first, second = cost, first
            elif cost < second:
                second = cost
        places[nearest, 6] = real(CORRELATED)
    return real(0.5) * (first + second) if count > 1 else first
