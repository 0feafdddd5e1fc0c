"""Cameras from the outlines of an object alone, view by view: epipolar tangents, and how far rays miss.

Two cameras and a plane through both that touches the object: it touches the outline in either picture (frontier points; Cipolla,
Astrom and Giblin, Motion from the Frontier of Curved Surfaces, ICCV 1995). So each pair of views gives two equations for their poses,
one on either side of the object. They are quick to measure, but many wrong poses fulfil them, too: `outline_coherence` tells.
"""

import numba
import numpy as np

from zeroshop_steps.geometry.cholesky import solve_by_cholesky
from zeroshop_steps.register.silhouettes.view_poses import UNKNOWNS, pose_view, pose_views

USUAL = np.array([np.inf, np.inf, 0.05, 0.2, 0.2, 0.12])
"""What views usually differ by from upright ones at one distance: radians, shares of the object's radius, and a logarithm."""
USUAL_FOCAL = 0.25  # of the logarithm of the focal length, from what was guessed
PRIOR = 0.02  # weight of these, against that of a pair
NO_TANGENT = 0.1  # cost of a pair whose line of centres passes through the object: its outlines have no tangents in common
NEAREST, LEAST_COSINE = 0.22, 0.05  # of that line to the object's centre, in distances; of rays to the plane through it and the centre
STEPS = np.array([1e-3, 1e-3, 1e-3, 2e-4, 2e-4, 1e-3])  # for derivatives
FOCAL_STEP = float(STEPS[-1])  # a logarithm, as that of the distance
TRIALS, CONVERGED = 6, 1e-3


@numba.njit(cache=True, fastmath=True, forceinline=True)
def compare_tangents(one, pose, other, other_pose, outlines, narrower, found):
    """Where the two planes through both centres that touch the other outline lie in one picture, beside its own outline.

    Fills (2, 4) `found`, for either side: by how much the outline reaches beyond the plane, the plane's normal (2), and how far the
    outline reaches along it. Returns whether there are such planes.
    """
    b0, b1, b2 = other_pose[12] - pose[12], other_pose[13] - pose[13], other_pose[14] - pose[14]
    length = np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
    if length < 1e-3:
        return False
    b0, b1, b2 = b0 / length, b1 / length, b2 / length
    along = pose[12] * b0 + pose[13] * b1 + pose[14] * b2
    p0, p1, p2 = along * b0 - pose[12], along * b1 - pose[13], along * b2 - pose[14]
    length = np.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    if length < NEAREST:
        return False
    p0, p1, p2 = p0 / length, p1 / length, p2 / length
    q0, q1, q2 = b1 * p2 - b2 * p1, b2 * p0 - b0 * p2, b0 * p1 - b1 * p0
    r = other_pose
    a0, a1, a2 = r[0] * p0 + r[1] * p1 + r[2] * p2, r[3] * p0 + r[4] * p1 + r[5] * p2, r[6] * p0 + r[7] * p1 + r[8] * p2
    e0, e1, e2 = r[0] * q0 + r[1] * q1 + r[2] * q2, r[3] * q0 + r[4] * q1 + r[5] * q2, r[6] * q0 + r[7] * q1 + r[8] * q2
    high, low = -1e9, 1e9
    for v in range(outlines.counts[other]):
        x, y = outlines.corners[other, v, 0] * narrower, outlines.corners[other, v, 1] * narrower
        cosine = a0 * x + a1 * y + a2
        if cosine < LEAST_COSINE:
            return False
        slope = (e0 * x + e1 * y + e2) / cosine
        high, low = max(high, slope), min(low, slope)
    r = pose
    a0, a1, a2 = r[0] * p0 + r[1] * p1 + r[2] * p2, r[3] * p0 + r[4] * p1 + r[5] * p2, r[6] * p0 + r[7] * p1 + r[8] * p2
    e0, e1, e2 = r[0] * q0 + r[1] * q1 + r[2] * q2, r[3] * q0 + r[4] * q1 + r[5] * q2, r[6] * q0 + r[7] * q1 + r[8] * q2
    for side in range(2):
        if side == 0:
            m0, m1, m2 = e0 - high * a0, e1 - high * a1, e2 - high * a2
        else:
            m0, m1, m2 = low * a0 - e0, low * a1 - e1, low * a2 - e2
        length = np.sqrt(m0 * m0 + m1 * m1)
        if length < 1e-6:
            return False
        m0, m1, m2 = m0 / length, m1 / length, m2 / length
        reach = -1e9
        for v in range(outlines.counts[one]):
            reach = max(reach, m0 * outlines.corners[one, v, 0] + m1 * outlines.corners[one, v, 1])
        reach *= narrower
        found[side, 0], found[side, 1], found[side, 2], found[side, 3] = reach + m2, m0, m1, reach
    return True


@numba.njit(cache=True, forceinline=True)
def _add_prior(view, size, weight, hessian, gradient, start):
    for a in range(2, 6):
        usual = USUAL[a] * (size if 3 <= a < 5 else 1.0)
        hessian[start + a, start + a] += weight / usual**2
        gradient[start + a] += weight * view[a] / usual**2


@numba.njit(cache=True, forceinline=True)
def measure_prior(view, size):
    """By how many times what is usual a view differs from an upright one at the usual distance: the sum of squares."""
    total = 0.0
    for a in range(2, 6):
        total += (view[a] / (USUAL[a] * (size if 3 <= a < 5 else 1.0))) ** 2
    return total


@numba.njit(cache=True, forceinline=True)
def shift_view(view, log_focal, number, placed, poses, outlines, tolerance, pose, found):
    """Move a view beside and along its axis, in place, by one step towards fitting the tangents; returns the cost before it."""
    narrower = np.exp(-log_focal)
    pose_view(view, log_focal, outlines.middle[number], pose)
    a00 = a01 = a02 = a11 = a12 = a22 = g0 = g1 = g2 = cost = 0.0
    unit = 1.0 / (outlines.size * tolerance)
    for other in placed:
        if not compare_tangents(number, pose, other, poses[other], outlines, narrower, found):
            cost += 2 * NO_TANGENT
            continue
        for side in range(2):
            r = found[side, 0] * unit
            w = 1.0 / (1.0 + r * r) ** 2
            j0, j1, j2 = -found[side, 1] * unit, -found[side, 2] * unit, found[side, 3] * unit
            a00 += w * j0 * j0
            a01 += w * j0 * j1
            a02 += w * j0 * j2
            a11 += w * j1 * j1
            a12 += w * j1 * j2
            a22 += w * j2 * j2
            g0 += w * j0 * r
            g1 += w * j1 * r
            g2 += w * j2 * r
            cost += r * r / (1.0 + r * r)
    weight = PRIOR * len(placed)
    aside, away = weight / (USUAL[3] * outlines.size) ** 2, weight / USUAL[5] ** 2
    g0, g1, g2 = g0 + aside * view[3], g1 + aside * view[4], g2 + away * view[5]
    a00, a11, a22 = a00 + aside, a11 + aside, a22 + away
    # Cramer's rule.
    c0, c1, c2 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    determinant = a00 * c0 + a01 * c1 + a02 * c2
    view[3] -= (c0 * g0 + c1 * g1 + c2 * g2) / determinant
    view[4] -= (c1 * g0 + (a00 * a22 - a02 * a02) * g1 + (a01 * a02 - a00 * a12) * g2) / determinant
    view[5] -= (c2 * g0 + (a01 * a02 - a00 * a12) * g1 + (a00 * a11 - a01 * a01) * g2) / determinant
    return cost


@numba.njit(cache=True, forceinline=True)
def _measure_tangents(views, log_focal, placed, outlines, tolerance):
    poses, found = pose_views(views, log_focal, placed, outlines), np.empty((2, 4))
    narrower, unit = np.exp(-log_focal), 1.0 / (outlines.size * tolerance)
    cost = PRIOR * (log_focal / USUAL_FOCAL) ** 2 * len(placed)
    for one in placed:
        cost += PRIOR * (len(placed) - 1) * measure_prior(views[one], outlines.size)
        for other in placed:
            if one == other:
                continue
            if compare_tangents(one, poses[one], other, poses[other], outlines, narrower, found):
                for side in range(2):
                    r = found[side, 0] * unit
                    cost += r * r / (1.0 + r * r)
            else:
                cost += 2 * NO_TANGENT
    return cost


@numba.njit(cache=True, forceinline=True)
def _linearize_tangents(views, log_focal, placed, outlines, tolerance, free_focal, free):
    """Gauss and Newton's approximation of the pairs that are free: (6 K + 1, 6 K + 1) matrix and (6 K + 1,) gradient."""
    count, last = len(placed), UNKNOWNS * len(placed)
    hessian, gradient = np.zeros((last + 1, last + 1)), np.zeros(last + 1)
    moved, changed = np.zeros((count, UNKNOWNS + 2, 15)), np.zeros(UNKNOWNS)
    for k in range(count):
        number = placed[k]
        pose_view(views[number], log_focal, outlines.middle[number], moved[k, 0])
        for a in range(UNKNOWNS):
            for b in range(UNKNOWNS):
                changed[b] = views[number, b] + STEPS[b] if a == b else views[number, b]
            pose_view(changed, log_focal, outlines.middle[number], moved[k, 1 + a])
        pose_view(views[number], log_focal + FOCAL_STEP, outlines.middle[number], moved[k, UNKNOWNS + 1])
        _add_prior(views[number], outlines.size, PRIOR * (count - 1), hessian, gradient, UNKNOWNS * k)
    hessian[last, last] += PRIOR * count / USUAL_FOCAL**2
    gradient[last] += PRIOR * count * log_focal / USUAL_FOCAL**2
    here, there, jacobian, columns = np.empty((2, 4)), np.empty((2, 4)), np.empty((2, 13)), np.empty(13, np.int64)
    narrower, unit = np.exp(-log_focal), 1.0 / (outlines.size * tolerance)
    for i in range(count):
        one = placed[i]
        for j in range(count):
            other = placed[j]
            if i == j or not (free_focal or free[i] or free[j]):
                continue
            if not compare_tangents(one, moved[i, 0], other, moved[j, 0], outlines, narrower, here):
                continue
            good = True
            for a in range(13):
                if not (free_focal if a == 12 else (free[i] if a < UNKNOWNS else free[j])):
                    jacobian[0, a] = jacobian[1, a] = 0.0  # what is not free does not move
                    columns[a] = last
                    continue
                first = 1 + a if a < UNKNOWNS else (UNKNOWNS + 1 if a == 12 else 0)
                second = a - 5 if UNKNOWNS <= a < 12 else (UNKNOWNS + 1 if a == 12 else 0)
                step = FOCAL_STEP if a == 12 else STEPS[a % UNKNOWNS]
                columns[a] = last if a == 12 else (UNKNOWNS * i + a if a < UNKNOWNS else UNKNOWNS * j + a - UNKNOWNS)
                narrowed = narrower * np.exp(-FOCAL_STEP) if a == 12 else narrower
                good = good and compare_tangents(one, moved[i, first], other, moved[j, second], outlines, narrowed, there)
                for side in range(2):
                    jacobian[side, a] = (there[side, 0] - here[side, 0]) / step * unit
            if not good:
                continue
            for side in range(2):
                r = here[side, 0] * unit
                w = 1.0 / (1.0 + r * r) ** 2
                for a in range(13):
                    gradient[columns[a]] += w * jacobian[side, a] * r
                    for b in range(13):
                        hessian[columns[a], columns[b]] += w * jacobian[side, a] * jacobian[side, b]
    return hessian, gradient


@numba.njit(cache=True)
def adjust_by_tangents(views, log_focal, placed, outlines, tolerance, rounds, free_focal, free):
    """Levenberg and Marquardt's method on the tangents of all pairs of views, under Geman and McClure's loss.

    Args:
        views: (N, 6).
        log_focal: logarithm of the factor of the focal length that was guessed.
        placed: (K,) numbers of the views that count.
        tolerance: scale of the loss, in radii of the object.
        rounds: at most.
        free_focal: whether the focal length is adjusted, too.
        free: (K,) bool, which of the views are.

    Returns:
        The views, the focal length and the cost.
    """
    views, damping, size = views.copy(), 1e-3, UNKNOWNS * len(placed) + 1
    cost = _measure_tangents(views, log_focal, placed, outlines, tolerance)
    for _ in range(rounds):
        hessian, gradient = _linearize_tangents(views, log_focal, placed, outlines, tolerance, free_focal, free)
        for a in range(size):
            if (a == size - 1 and not free_focal) or (a < size - 1 and not free[a // UNKNOWNS]):
                for b in range(size):
                    hessian[a, b] = hessian[b, a] = 0.0
                hessian[a, a], gradient[a] = 1.0, 0.0
        mean, done = np.trace(hessian) / size, True
        for _ in range(TRIALS):
            damped = hessian.copy()
            for a in range(size):
                damped[a, a] += damping * hessian[a, a] + 1e-7 * mean
            step = gradient.copy()
            solve_by_cholesky(damped, step)
            trial = views.copy()
            for a in range(UNKNOWNS * len(placed)):
                trial[placed[a // UNKNOWNS], a % UNKNOWNS] -= step[a]
            reached = np.inf
            if np.abs(step).max() < 1.0:
                reached = _measure_tangents(trial, log_focal - step[size - 1], placed, outlines, tolerance)
            if reached < cost:
                done = cost - reached < CONVERGED * cost
                views, log_focal, cost, damping = trial, log_focal - step[size - 1], reached, max(damping / 5, 1e-7)
                break
            damping *= 5
        if done:
            break
    return views, log_focal, cost
