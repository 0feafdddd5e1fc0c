"""How far rays through the rims of masks miss the other masks, coarsely and quickly, for many poses; see `epipolar_tangency`.

Every ray through a rim touches the object, so some point of it lies in all other masks. `rays` measures the same finely.
"""

import numba
import numpy as np

from zeroshop_steps.register.silhouettes.epipolar_tangency import measure_prior, shift_view
from zeroshop_steps.register.silhouettes.view_poses import UNKNOWNS, pose_view, pose_views

DEPTHS, FINER, LEVELS = 24, 5, 3  # along a ray, within the object; then between the neighbours of the best, so often
REACH = 1.25  # of the depths, in radii of the object
FARTHEST_PX = 60.0  # of a miss: beyond, farther is not worse
PRIOR_PX = 0.3  # for a view that is unusual by one standard deviation
ROUGH, FINE = 0.3, 0.1  # tolerances of the tangents while a view is laid


@numba.njit(cache=True, fastmath=True, forceinline=True)
def _look_up(view, outlines, narrower, x, y, z):
    """Signed distance of a point of a camera's frame in its small mask, between its pixels linearly; as at the border beyond it."""
    if z < 1e-3:
        return -np.float32(FARTHEST_PX)
    distance, unit = outlines.distance, outlines.scale[view] / (narrower * z)
    u = x * unit + outlines.principal[view, 0] - 0.5
    v = y * unit + outlines.principal[view, 1] - 0.5
    u, v = min(max(u, 0.0), distance.shape[2] - 1.001), min(max(v, 0.0), distance.shape[1] - 1.001)
    column, row = int(u), int(v)
    u, v = u - column, v - row
    upper = distance[view, row, column] * (1 - u) + distance[view, row, column + 1] * u
    lower = distance[view, row + 1, column] * (1 - u) + distance[view, row + 1, column + 1] * u
    return upper * (1 - v) + lower * v


@numba.njit(cache=True, forceinline=True)
def _trace_ray(number, m, poses, placed, outlines, narrower, lines):
    """Fill (K, 6) `lines`: where the ray through a rim begins in the frames of the placed views, and how it runs there with its depth.

    Returns its direction in the world (3).
    """
    x, y = outlines.rims[number, m, 0] * narrower, outlines.rims[number, m, 1] * narrower
    dx = poses[number, 0] * x + poses[number, 3] * y + poses[number, 6]
    dy = poses[number, 1] * x + poses[number, 4] * y + poses[number, 7]
    dz = poses[number, 2] * x + poses[number, 5] * y + poses[number, 8]
    cx, cy, cz = poses[number, 12], poses[number, 13], poses[number, 14]
    for k in range(len(placed)):
        other = placed[k]
        for i in range(3):
            a, b, c = poses[other, 3 * i], poses[other, 3 * i + 1], poses[other, 3 * i + 2]
            lines[k, i] = a * cx + b * cy + c * cz + poses[other, 9 + i]
            lines[k, 3 + i] = a * dx + b * dy + c * dz
    return dx, dy, dz


@numba.njit(cache=True, forceinline=True)
def _look_at_depth(number, depth, lines, placed, outlines, narrower, enough):
    """The least signed distance of a point of a ray in the masks but its own, or something below `enough`."""
    least = FARTHEST_PX
    for k in range(len(placed)):
        if placed[k] != number:
            x, y, z = lines[k, 0] + depth * lines[k, 3], lines[k, 1] + depth * lines[k, 4], lines[k, 2] + depth * lines[k, 5]
            least = min(least, _look_up(placed[k], outlines, narrower, x, y, z))
            if least <= enough:
                break
    return least


@numba.njit(cache=True, forceinline=True)
def measure_view(number, placed, poses, outlines, narrower, every, enough):
    """By how much every so many-th ray of one view misses the other masks, px per 1000 px in the mean, or something above `enough`."""
    lines, total, rays = np.empty((len(placed), 6)), 0.0, (outlines.rims.shape[1] + every - 1) // every
    middle = poses[number, 11]
    reach = REACH * outlines.size * middle
    for m in range(0, outlines.rims.shape[1], every):
        _trace_ray(number, m, poses, placed, outlines, narrower, lines)
        best, where, gap = -FARTHEST_PX, middle, 2 * reach / (DEPTHS - 1)
        for s in range(DEPTHS):
            # From the middle outwards: most rays meet the object there, and what is good spares a look at what is worse.
            away = (s + 1) // 2 if s % 2 else -(s // 2)
            depth = middle - reach + (DEPTHS // 2 - 1 + away) * gap
            value = _look_at_depth(number, depth, lines, placed, outlines, narrower, best)
            if value > best:
                best, where = value, depth
                if best >= 0:  # it meets all masks, and need not meet them better
                    break
        for _ in range(LEVELS):
            if best >= 0:
                break
            gap, around = 2 * gap / (FINER + 1), where
            for s in range(1, FINER + 1):
                depth = around + (s - (FINER + 1) / 2) * gap
                value = _look_at_depth(number, depth, lines, placed, outlines, narrower, best)
                if value > best:
                    best, where = value, depth
        total += max(-best, 0.0)
        if total > enough * rays:
            break
    return total / rays


@numba.njit(cache=True)
def measure_misses(views, log_focal, placed, outlines, every):
    """(K,) by how much the rays of each placed view miss the other masks, px per 1000 px in the mean."""
    poses, misses = pose_views(views, log_focal, placed, outlines), np.empty(len(placed))
    for k in range(len(placed)):
        misses[k] = measure_view(placed[k], placed, poses, outlines, np.exp(-log_focal), every, np.inf)
    return misses


@numba.njit(cache=True, forceinline=True)
def sample_rays(placed, poses, outlines, narrower, every):
    """(R, DEPTHS, 4) points of the rays of placed views, and their least signed distances in the others' masks, the largest first."""
    rays = (outlines.rims.shape[1] + every - 1) // every
    samples, lines = np.empty((len(placed) * rays, DEPTHS, 4), np.float32), np.empty((len(placed), 6))
    for k in range(len(placed)):
        number = placed[k]
        middle = poses[number, 11]
        reach = REACH * outlines.size * middle
        for m in range(rays):
            dx, dy, dz = _trace_ray(number, m * every, poses, placed, outlines, narrower, lines)
            for s in range(DEPTHS):
                depth = middle - reach + s * 2 * reach / (DEPTHS - 1)
                value = _look_at_depth(number, depth, lines, placed, outlines, narrower, -FARTHEST_PX)
                at, ray = s, samples[k * rays + m]
                while at > 0 and ray[at - 1, 3] < value:
                    for i in range(4):
                        ray[at, i] = ray[at - 1, i]
                    at -= 1
                ray[at, 0], ray[at, 1] = poses[number, 12] + depth * dx, poses[number, 13] + depth * dy
                ray[at, 2], ray[at, 3] = poses[number, 14] + depth * dz, value
    return samples


@numba.njit(cache=True, forceinline=True)
def _insert(lowest, cost):
    """Put a cost into its place among ascending ones, of which the last is dropped."""
    at = len(lowest) - 1
    while at > 0 and lowest[at - 1] > cost:
        lowest[at] = lowest[at - 1]
        at -= 1
    lowest[at] = cost


@numba.njit(cache=True)
def try_places(number, places, views, log_focal, placed, outlines, every, wanted):
    """Lay a view to those that are placed, at each of many azimuths and elevations.

    Args:
        number: of the view.
        places: (L, 2) azimuths and elevations, radians.
        views, log_focal, placed, outlines: as in `adjust_by_tangents`.
        every: so many-th ray is looked at.
        wanted: how many of the places with the lowest costs are; the others are given up as soon as they cost more than all of these.

    Returns:
        (L,) cost, px per 1000 px: by how much its rays and those of the others miss, and how unusual its place is; of a place that was
        given up, what it had reached. (L, 6) the view there.
    """
    narrower = np.exp(-log_focal)
    poses = pose_views(views, log_focal, placed, outlines)
    samples = sample_rays(placed, poses, outlines, narrower, every)
    costs, laid = np.empty(len(places)), np.zeros((len(places), UNKNOWNS))
    pose, found, both = np.empty(15), np.empty((2, 4)), np.empty(len(placed) + 1, np.int64)
    for k in range(len(placed)):  # number by number, here and below: assignments of arrays take seconds to compile
        both[k] = placed[k]
    both[-1] = number
    lowest = np.full(wanted, np.inf)  # costs of the best places so far, ascending
    for k in range(len(places)):
        view = laid[k]
        view[0], view[1] = places[k, 0], places[k, 1]
        for tolerance in (ROUGH, FINE):
            shift_view(view, log_focal, number, placed, poses, outlines, tolerance, pose, found)
        pose_view(view, log_focal, outlines.middle[number], pose)
        for i in range(len(pose)):
            poses[number, i] = pose[i]
        cost = PRIOR_PX * measure_prior(view, outlines.size)
        for r in range(len(samples)):
            best = np.float32(-FARTHEST_PX)
            for s in range(DEPTHS):
                sample = samples[r, s]
                if sample[3] <= best:  # as are those behind it
                    break
                value = _look_up(
                    number, outlines, narrower,
                    pose[0] * sample[0] + pose[1] * sample[1] + pose[2] * sample[2] + pose[9],
                    pose[3] * sample[0] + pose[4] * sample[1] + pose[5] * sample[2] + pose[10],
                    pose[6] * sample[0] + pose[7] * sample[1] + pose[8] * sample[2] + pose[11],
                )  # fmt: skip
                best = max(best, min(value, sample[3]))
                if best >= 0:
                    break
            cost += 0.5 * max(-best, 0.0) / len(samples)
            if cost > lowest[-1]:
                break
        if cost <= lowest[-1]:
            cost += 0.5 * measure_view(number, both, poses, outlines, narrower, every, 2 * (lowest[-1] - cost))
        if cost <= lowest[-1]:
            _insert(lowest, cost)
        costs[k] = cost
    return costs, laid
