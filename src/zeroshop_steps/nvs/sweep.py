"""Seeds on the object's surface by plane sweep: for each pixel, the depth within the visual hull at which views agree.

The visual hull closes every hollow with a lid. Photographs know better wherever the surface has any shading or print:
each reference pixel is swept through its interval of the hull, and patches of the neighbouring views are compared
with its own by normalized cross-correlation and colour (Collins 1996; Goesele et al. 2007 for the choice of the best
views). Depths that several views confirm become seeds.
"""

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from zeroshop_steps.cameras import Camera
from zeroshop_steps.nvs.views import TrainingView

DEPTHS = 64
NEIGHBOURS = 6
PATCH_RADIUS_PX = 2
NOISE = 0.02
"""Noise of the luminance, added to the patches' variances: patches without contrast correlate with nothing."""
COLOR_WEIGHT = 4.0
TOLERANCE = 0.015
"""Largest difference, in normalized units, between depths of two views that confirm each other."""
CONFIRMATIONS = 2
STRIDE_PX = 2
"""Every second pixel of every second row is swept."""
BEST_VIEWS = 3
"""The cost of a depth is the mean over this many of its best neighbours: some are always occluded."""


@dataclass(frozen=True)
class Seeds:
    """Confirmed surface points.

    Attributes:
        positions: (N, 3), colors: (N, 3) RGB in [0, 1], normals: (N, 3) towards the view that found the seed.
        depth_maps: for each view, (H, W) float32 depth along the optical axis, 0 where nothing was confirmed.
    """

    positions: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    depth_maps: list[np.ndarray]


def neighbours_of(cameras: list[Camera], count: int = NEIGHBOURS) -> np.ndarray:
    """(V, count) indices of the views whose directions to the origin are nearest."""
    directions = np.array([camera.centre_in_world for camera in cameras])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    order = np.argsort(-(directions @ directions.T), axis=1, kind="stable")
    return np.ascontiguousarray(order[:, 1 : count + 1])


def sweep_seeds(views: list[TrainingView], occupied: np.ndarray, half_extent: float, cost_max: float = 0.35) -> Seeds:
    """Seeds of small views (about 250 px wide images are enough) within a voxel hull.

    Args:
        views: training views in normalized coordinates.
        occupied: (R, R, R) bool visual hull within the cube of +-half_extent.
        cost_max: depths with a higher cost are not confirmed.
    """
    cameras = [view.camera for view in views]
    rows = np.array([camera.row for camera in cameras])
    neighbours = neighbours_of(cameras, min(NEIGHBOURS, len(views) - 1))
    height, width = max(c.height_px for c in cameras), max(c.width_px for c in cameras)
    stack = np.zeros((len(views), height, width, 4), np.float32)
    masks = np.zeros((len(views), height, width), np.bool_)
    for i, view in enumerate(views):
        color = cv2.GaussianBlur(np.ascontiguousarray(view.color.numpy().transpose(1, 2, 0)), (0, 0), 0.6)
        stack[i, : color.shape[0], : color.shape[1], :3] = color
        stack[i, : color.shape[0], : color.shape[1], 3] = color.mean(axis=2)
        masks[i, : color.shape[0], : color.shape[1]] = view.mask.numpy() > 0.5
    sizes = np.array([[c.height_px, c.width_px] for c in cameras])
    depth, cost = np.zeros(masks.shape, np.float32), np.ones(masks.shape, np.float32)
    for i in range(len(views)):
        _sweep(i, rows, neighbours[i], stack, masks, sizes, occupied, half_extent, depth[i], cost[i])
    depth[cost > cost_max] = 0.0
    confirmed = _confirm(depth, rows, neighbours, sizes, TOLERANCE)
    depth[confirmed < CONFIRMATIONS] = 0.0
    maps = [depth[i, : c.height_px, : c.width_px] for i, c in enumerate(cameras)]
    positions, colors, normals = [], [], []
    for camera, view, found in zip(cameras, views, maps, strict=True):
        y, x = np.nonzero(found)
        k = camera.intrinsics
        rays = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1], np.ones(len(x))], 1)
        world = (rays * found[y, x][:, None] - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]
        towards = camera.centre_in_world - world
        positions.append(world)
        colors.append(view.color.numpy()[:, y, x].T)
        normals.append(towards / np.linalg.norm(towards, axis=1, keepdims=True))
    return Seeds(np.concatenate(positions), np.concatenate(colors), np.concatenate(normals), maps)


@numba.njit(cache=True)
def _project(row, x, y, z):
    px = row[0] * x + row[1] * y + row[2] * z + row[9]
    py = row[3] * x + row[4] * y + row[5] * z + row[10]
    pz = row[6] * x + row[7] * y + row[8] * z + row[11]
    return row[12] * px / pz + row[14] - 0.5, row[13] * py / pz + row[15] - 0.5, pz


@numba.njit(cache=True, fastmath=True)
def _patch_cost(reference, color, image, height, width, u0, v0, dux, dvx, duy, dvy):
    """Half of one less the normalized cross-correlation of two patches, and the difference of their colours; 2 outside the image.

    Args:
        reference: (side, side) luminance around the reference pixel, and `color` (3,) at it.
        image: (H, W, 4) RGB and luminance of the other view.
        u0, v0: where the reference pixel lands; the patch follows its neighbours by (dux, dvx) along x and (duy, dvy) along y.
    """
    r0 = PATCH_RADIUS_PX
    reach_u, reach_v = r0 * (abs(dux) + abs(duy)), r0 * (abs(dvx) + abs(dvy))
    if u0 - reach_u < 0 or v0 - reach_v < 0 or u0 + reach_u >= width - 1 or v0 + reach_v >= height - 1:
        return 2.0
    sum_a = sum_b = sum_aa = sum_bb = sum_ab = 0.0
    for j in range(2 * r0 + 1):
        for i in range(2 * r0 + 1):
            u = u0 + (i - r0) * dux + (j - r0) * duy
            v = v0 + (i - r0) * dvx + (j - r0) * dvy
            x, y = int(u), int(v)
            fx, fy = u - x, v - y
            top = image[y, x, 3] * (1 - fx) + image[y, x + 1, 3] * fx
            b = top * (1 - fy) + (image[y + 1, x, 3] * (1 - fx) + image[y + 1, x + 1, 3] * fx) * fy
            a = reference[j, i]
            sum_a += a
            sum_b += b
            sum_aa += a * a
            sum_bb += b * b
            sum_ab += a * b
    n = (2 * r0 + 1) ** 2
    noise = n * NOISE**2
    spread = np.sqrt((sum_aa - sum_a * sum_a / n + noise) * (sum_bb - sum_b * sum_b / n + noise))
    x, y = int(u0 + 0.5), int(v0 + 0.5)
    difference = abs(color[0] - image[y, x, 0]) + abs(color[1] - image[y, x, 1]) + abs(color[2] - image[y, x, 2])
    return 0.5 * (1.0 - (sum_ab - sum_a * sum_b / n) / spread) + COLOR_WEIGHT * difference / 3


@numba.njit(cache=True, parallel=True, fastmath=True)
def _sweep(index, rows, neighbours, stack, masks, sizes, occupied, half, depth, cost):
    resolution = occupied.shape[0]
    row = rows[index]
    height, width = sizes[index]
    r0 = PATCH_RADIUS_PX
    centre = np.empty(3)
    for c in range(3):
        centre[c] = -(row[c] * row[9] + row[3 + c] * row[10] + row[6 + c] * row[11])
    for line in numba.prange((height - 2 * r0) // STRIDE_PX):
        y = r0 + line * STRIDE_PX
        costs = np.empty(DEPTHS)
        best = np.empty(len(neighbours))
        reference = np.empty((2 * r0 + 1, 2 * r0 + 1), np.float32)
        ray, side_x, side_y = np.empty(3), np.empty(3), np.empty(3)
        for x in range(r0, width - r0, STRIDE_PX):
            if not masks[index, y, x]:
                continue
            dx, dy = (x + 0.5 - row[14]) / row[12], (y + 0.5 - row[15]) / row[13]
            for c in range(3):
                ray[c] = row[c] * dx + row[3 + c] * dy + row[6 + c]
                side_x[c], side_y[c] = row[c] / row[12], row[3 + c] / row[13]
            near, far = _interval(centre, ray, occupied, half, resolution)
            if far <= near:
                continue
            for j in range(2 * r0 + 1):
                for i in range(2 * r0 + 1):
                    reference[j, i] = stack[index, y + j - r0, x + i - r0, 3]
            lowest, lowest_at = 1e9, 0
            for d in range(DEPTHS):
                z = near + (far - near) * d / (DEPTHS - 1)
                px, py, pz = centre[0] + z * ray[0], centre[1] + z * ray[1], centre[2] + z * ray[2]
                for n in range(len(neighbours)):
                    other = rows[neighbours[n]]
                    u0, v0, _ = _project(other, px, py, pz)
                    ux, vx, _ = _project(other, px + z * side_x[0], py + z * side_x[1], pz + z * side_x[2])
                    uy, vy, _ = _project(other, px + z * side_y[0], py + z * side_y[1], pz + z * side_y[2])
                    oh, ow = sizes[neighbours[n]]
                    best[n] = _patch_cost(
                        reference, stack[index, y, x], stack[neighbours[n]], oh, ow, u0, v0, ux - u0, vx - v0, uy - u0, vy - v0
                    )
                best.sort()
                costs[d] = best[: min(BEST_VIEWS, len(best))].mean()
                if costs[d] < lowest:
                    lowest, lowest_at = costs[d], d
            # A depth counts only when it is clearly better than those far from it.
            rival = 1e9
            for d in range(DEPTHS):
                if abs(d - lowest_at) > 5 and costs[d] < rival:
                    rival = costs[d]
            shift = 0.0
            if 0 < lowest_at < DEPTHS - 1:
                bend = costs[lowest_at - 1] - 2 * lowest + costs[lowest_at + 1]
                if bend > 1e-9:
                    shift = 0.5 * (costs[lowest_at - 1] - costs[lowest_at + 1]) / bend
            if lowest < 0.95 * rival:
                depth[y, x] = near + (far - near) * (lowest_at + shift) / (DEPTHS - 1)
                cost[y, x] = lowest


@numba.njit(cache=True)
def _interval(centre, ray, occupied, half, resolution):
    """First and last depth at which the ray is inside the voxel hull, widened by a voxel; near 1, far 0 when it misses."""
    step = half / resolution
    distance = np.sqrt(centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
    length = np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
    z = max((distance - 1.8 * half) / length, 1e-3)
    end = (distance + 1.8 * half) / length
    near, far = 1.0, 0.0
    found = False
    while z < end:
        i = int((centre[0] + z * ray[0] + half) / (2 * step))
        j = int((centre[1] + z * ray[1] + half) / (2 * step))
        k = int((centre[2] + z * ray[2] + half) / (2 * step))
        if 0 <= i < resolution and 0 <= j < resolution and 0 <= k < resolution and occupied[i, j, k]:
            if not found:
                near, found = z, True
            far = z
        z += step
    return (near - 2 * step, far + 2 * step) if found else (1.0, 0.0)


@numba.njit(cache=True, parallel=True)
def _confirm(depth, rows, neighbours, sizes, tolerance):
    """(V, H, W) number of neighbours whose own depth, at the place where a point projects, agrees within the tolerance."""
    confirmed = np.zeros(depth.shape, np.int32)
    for index in numba.prange(depth.shape[0]):
        row = rows[index]
        for y in range(sizes[index, 0]):
            for x in range(sizes[index, 1]):
                z = depth[index, y, x]
                if z <= 0:
                    continue
                dx, dy = (x + 0.5 - row[14]) / row[12], (y + 0.5 - row[15]) / row[13]
                a, b, c = z * dx - row[9], z * dy - row[10], z - row[11]
                wx, wy, wz = (
                    row[0] * a + row[3] * b + row[6] * c,
                    row[1] * a + row[4] * b + row[7] * c,
                    row[2] * a + row[5] * b + row[8] * c,
                )
                for n in neighbours[index]:
                    u, v, expected = _project(rows[n], wx, wy, wz)
                    # The nearest swept pixel.
                    r0, stride = PATCH_RADIUS_PX, STRIDE_PX
                    i = r0 + stride * int(np.floor((u - r0) / stride + 0.5))
                    j = r0 + stride * int(np.floor((v - r0) / stride + 0.5))
                    if 0 <= i < sizes[n, 1] and 0 <= j < sizes[n, 0] and abs(depth[n, j, i] - expected) < tolerance:
                        confirmed[index, y, x] += 1
    return confirmed
