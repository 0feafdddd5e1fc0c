"""How far rays through the rims of masks miss the other masks, coarsely and quickly, for many poses; see `outline_tangents`.

Every ray through a rim touches the object, so some point of it lies in all other masks. `outline_rays` measures the same finely.
"""

import numba
import numpy as np

from zeroshop_steps.register.outline_tangents import SIZE, measure_prior, pose_view, shift_view

DEPTHS, FINER, LEVELS = 24, 5, 3  # along a ray, within the object; then between the neighbours of the best, so often
REACH = 1.25  # of the depths, in radii of the object
FARTHEST_PX = 60.0  # of a miss: beyond, farther is not worse
PRIOR_PX = 0.3  # for a view that is unusual by one standard deviation
ROUGH, FINE = 0.3, 0.1  # tolerances of the tangents while a view is laid


@numba.njit(cache=True, fastmath=True, forceinline=True)
def _look_up(distance, scale, principal, pose, narrower, x, y, z):
    """Signed distance of a point in a view's small mask, between its pixels linearly; as at the border beyond it."""
    depth = pose[6] * x + pose[7] * y + pose[8] * z + pose[11]
    if depth < 1e-3:
        return -np.float32(FARTHEST_PX)
    unit = scale / (narrower * depth)
    u = (pose[0] * x + pose[1] * y + pose[2] * z + pose[9]) * unit + principal[0] - 0.5
    v = (pose[3] * x + pose[4] * y + pose[5] * z + pose[10]) * unit + principal[1] - 0.5
    height, width = distance.shape
    u, v = min(max(u, 0.0), width - 1.001), min(max(v, 0.0), height - 1.001)
    column, row = int(u), int(v)
    u, v = u - column, v - row
    upper = distance[row, column] * (1 - u) + distance[row, column + 1] * u
    lower = distance[row + 1, column] * (1 - u) + distance[row + 1, column + 1] * u
    return upper * (1 - v) + lower * v


@numba.njit(cache=True, forceinline=True)
def _place_on_ray(pose, rim, narrower, depth, point):
    """Fill (3,) `point` at a depth on the ray through a rim."""
    a, b, c = rim[0] * narrower * depth - pose[9], rim[1] * narrower * depth - pose[10], depth - pose[11]
    for k in range(3):
        point[k] = pose[k] * a + pose[3 + k] * b + pose[6 + k] * c


@numba.njit(cache=True, forceinline=True)
def _look_at_depth(number, m, depth, placed, poses, outlines, narrower, enough, point):
    """The least signed distance of a point of a ray in the other masks, or something below `enough`."""
    _place_on_ray(poses[number], outlines.rims[number, m], narrower, depth, point)
    least = np.float32(FARTHEST_PX)
    for other in placed:
        if other != number:
            value = _look_up(
                outlines.distance[other], outlines.scale[other], outlines.principal[other], poses[other], narrower,
                point[0], point[1], point[2],
            )  # fmt: skip
            least = min(least, value)
            if least <= enough:
                break
    return least


@numba.njit(cache=True, forceinline=True)
def measure_view(number, placed, poses, outlines, narrower, every):
    """By how much every so many-th ray of one view misses the other masks, px per 1000 px in the mean."""
    point, total, rays = np.empty(3), 0.0, 0
    middle = poses[number][11]
    reach = REACH * outlines.size * middle
    for m in range(0, outlines.rims.shape[1], every):
        best, where, gap = np.float32(-FARTHEST_PX), middle, 2 * reach / (DEPTHS - 1)
        for s in range(DEPTHS):
            depth = middle - reach + s * gap
            value = _look_at_depth(number, m, depth, placed, poses, outlines, narrower, best, point)
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
                value = _look_at_depth(number, m, depth, placed, poses, outlines, narrower, best, point)
                if value > best:
                    best, where = value, depth
        total += max(-best, 0.0)
        rays += 1
    return total / rays


@numba.njit(cache=True, forceinline=True)
def pose_views(views, log_focal, placed, outlines):
    """(N, 15) poses of the placed views."""
    poses = np.zeros((len(outlines.counts), 15))
    for number in placed:
        pose_view(views[number], log_focal, outlines.middle[number], poses[number])
    return poses


@numba.njit(cache=True)
def measure_misses(views, log_focal, placed, outlines, every):
    """(K,) by how much the rays of each placed view miss the other masks, px per 1000 px in the mean."""
    poses, misses = pose_views(views, log_focal, placed, outlines), np.empty(len(placed))
    for k in range(len(placed)):
        misses[k] = measure_view(placed[k], placed, poses, outlines, np.exp(-log_focal), every)
    return misses


@numba.njit(cache=True, forceinline=True)
def sample_rays(placed, poses, outlines, narrower, every):
    """(R, DEPTHS, 4) points of the rays of placed views, and their least signed distances in the others' masks."""
    rays = (outlines.rims.shape[1] + every - 1) // every
    samples, point = np.empty((len(placed) * rays, DEPTHS, 4), np.float32), np.empty(3)
    for k in range(len(placed)):
        number = placed[k]
        middle = poses[number][11]
        reach = REACH * outlines.size * middle
        for m in range(rays):
            for s in range(DEPTHS):
                depth = middle - reach + s * 2 * reach / (DEPTHS - 1)
                value = _look_at_depth(number, m * every, depth, placed, poses, outlines, narrower, -FARTHEST_PX, point)
                sample = samples[k * rays + m, s]
                sample[0], sample[1], sample[2], sample[3] = point[0], point[1], point[2], value
    return samples


@numba.njit(cache=True)
def try_places(number, places, views, log_focal, placed, outlines, every):
    """Lay a view to those that are placed, at each of many azimuths and elevations.

    Args:
        number: of the view.
        places: (L, 2) azimuths and elevations, radians.
        views, log_focal, placed, outlines: as in `adjust_by_tangents`.
        every: so many-th ray is looked at.

    Returns:
        (L,) cost, px per 1000 px: by how much its rays and those of the others miss, and how unusual its place is; (L, 6) the view there.
    """
    narrower = np.exp(-log_focal)
    poses = pose_views(views, log_focal, placed, outlines)
    samples = sample_rays(placed, poses, outlines, narrower, every)
    costs, laid = np.empty(len(places)), np.zeros((len(places), SIZE))
    pose, found, both = np.empty(15), np.empty((2, 4)), np.empty(len(placed) + 1, np.int64)
    for k in range(len(placed)):  # number by number, here and below: assignments of arrays take seconds to compile
        both[k] = placed[k]
    both[-1] = number
    for k in range(len(places)):
        view = laid[k]
        view[0], view[1] = places[k, 0], places[k, 1]
        for tolerance in (ROUGH, FINE):
            shift_view(view, log_focal, number, placed, poses, outlines, tolerance, pose, found)
        pose_view(view, log_focal, outlines.middle[number], pose)
        for i in range(len(pose)):
            poses[number, i] = pose[i]
        total = 0.0
        for r in range(len(samples)):
            best = np.float32(-FARTHEST_PX)
            for s in range(DEPTHS):
                sample = samples[r, s]
                if sample[3] > best:
                    value = _look_up(
                        outlines.distance[number], outlines.scale[number], outlines.principal[number], pose, narrower,
                        sample[0], sample[1], sample[2],
                    )  # fmt: skip
                    best = max(best, min(value, sample[3]))
                    if best >= 0:
                        break
            total += max(-best, 0.0)
        own = measure_view(number, both, poses, outlines, narrower, every)
        costs[k] = 0.5 * total / len(samples) + 0.5 * own + PRIOR_PX * measure_prior(view, outlines.size)
    return costs, laid
