"""Many poses of one model at once, stepped towards measured points (point-to-plane ICP) and judged by shape."""

import numba
import numpy as np

from zeroshop_steps.pose.nearest_surface import NearestSurface

NEAR_SHARE = 0.85
LARGEST_TURN = 0.4
DAMPING = 1e-3
JUDGED_SHARE = 0.95
AWAY_DIAMETERS = 0.05
SEEN_SAMPLES = 400
CONFLICT_MM = 12.0
CONFLICT_DIAMETERS = 0.1


def run_icp(poses: np.ndarray, points: np.ndarray, surface: NearestSurface, steps: int) -> np.ndarray:
    """(P, 4, 4) camera_from_model after `steps` steps of point-to-plane ICP (Chen and Medioni 1991) towards (N, 3) points, mm.

    The farthest points count for nothing, nor do those that would lie on a surface which faces away, unless the model may be hollow.
    """
    moved = np.ascontiguousarray(poses, np.float64).copy()
    tables = surface.points, surface.normals, surface.is_open, surface.low, surface.cell_mm, surface.table
    _run_icp(moved, np.ascontiguousarray(points, np.float64), *tables, steps)
    return moved


def compute_shape_costs(
    poses: np.ndarray, points: np.ndarray, surface: NearestSurface, diameter_mm: float, depth_mm: np.ndarray, mask: np.ndarray,
    intrinsics: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(P,) mean distance of the nearer points in diameters, and more for the share of the surface that the image contradicts.

    Args:
        poses: (P, 4, 4) camera_from_model.
        points: (N, 3) measured points on the object, mm.
        surface: of the model.
        diameter_mm: of the model.
        depth_mm: (height, width) measured depth of the scene, 0 where there is none.
        mask: (height, width) bool, the object's visible pixels.
        intrinsics: (3, 3) BOP's K.
    """
    poses, points = np.ascontiguousarray(poses, np.float64), np.ascontiguousarray(points, np.float64)
    tables = surface.points, surface.normals, surface.is_open, surface.low, surface.cell_mm, surface.table
    focal = np.array([intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]], np.float64)
    return _compute_costs(poses, points, *tables, float(diameter_mm), depth_mm, mask, focal)


@numba.njit(cache=True)
def _to_model_frame(pose, point, out):
    """The point in the model's frame."""
    for axis in range(3):
        out[axis] = 0.0
        for row in range(3):
            out[axis] += pose[row, axis] * (point[row] - pose[row, 3])


@numba.njit(cache=True)
def _look_up_nearest(local, low, cell_mm, table):
    """The sample nearest to a point in the model's frame, as the table knows it."""
    x = min(max(int((local[0] - low[0]) / cell_mm), 0), table.shape[0] - 1)
    y = min(max(int((local[1] - low[1]) / cell_mm), 0), table.shape[1] - 1)
    z = min(max(int((local[2] - low[2]) / cell_mm), 0), table.shape[2] - 1)
    return table[x, y, z]


@numba.njit(cache=True)
def _rotate(pose, vector, out):
    """A direction of the model's frame in the camera's."""
    for row in range(3):
        out[row] = pose[row, 0] * vector[0] + pose[row, 1] * vector[1] + pose[row, 2] * vector[2]


@numba.njit(cache=True, parallel=True)
def _run_icp(poses, points, samples, normals, is_open, low, cell_mm, table, steps):
    middle = np.array([points[:, 0].mean(), points[:, 1].mean(), points[:, 2].mean()])
    for index in numba.prange(len(poses)):
        distances, faces = np.empty(len(points)), np.empty(len(points), np.bool_)
        rows, gaps = np.empty((len(points), 6)), np.empty(len(points))
        for _ in range(steps):
            _build_equations(poses[index], points, middle, samples, normals, is_open, low, cell_mm, table, distances, faces, rows, gaps)
            limit = np.sort(distances)[int(np.ceil(NEAR_SHARE * (len(points) - 1)))]
            square, right = np.zeros((6, 6)), np.zeros(6)
            for point in range(len(points)):
                if faces[point] and distances[point] <= limit:
                    for i in range(6):
                        right[i] += rows[point, i] * gaps[point]
                        for j in range(6):
                            square[i, j] += rows[point, i] * rows[point, j]
            for i in range(6):
                square[i, i] += DAMPING * square[i, i] + 1e-6
            _apply_step(poses[index], np.linalg.solve(square, right), middle)


@numba.njit(cache=True)
def _build_equations(pose, points, middle, samples, normals, is_open, low, cell_mm, table, distances, faces, rows, gaps):
    """For each point: how far it is off, whether the surface there faces the camera, and its equation of the step."""
    local, normal, target = np.empty(3), np.empty(3), np.empty(3)
    for point in range(len(points)):
        _to_model_frame(pose, points[point], local)
        sample = _look_up_nearest(local, low, cell_mm, table)
        _rotate(pose, normals[sample], normal)
        _rotate(pose, samples[sample], target)
        squared, towards, gap = 0.0, 0.0, 0.0
        for axis in range(3):
            squared += (local[axis] - samples[sample, axis]) ** 2
            towards += normal[axis] * points[point, axis]
            target[axis] += pose[axis, 3]
            gap += (points[point, axis] - target[axis]) * normal[axis]
            rows[point, 3 + axis] = normal[axis]
        distances[point], faces[point], gaps[point] = np.sqrt(squared), is_open or towards < 0, gap
        for axis in range(3):
            after, last = (axis + 1) % 3, (axis + 2) % 3
            rows[point, axis] = (target[after] - middle[after]) * normal[last] - (target[last] - middle[last]) * normal[after]


@numba.njit(cache=True)
def _apply_step(pose, change, middle):
    """Turn a pose about the middle by change[:3] and move it by change[3:], in place."""
    x, y, z = np.minimum(np.maximum(change[:3], -LARGEST_TURN), LARGEST_TURN)
    angle = np.sqrt(x * x + y * y + z * z)
    first = 1.0 - angle**2 / 6 if angle < 1e-4 else np.sin(angle) / angle
    second = 0.5 - angle**2 / 24 if angle < 1e-4 else (1.0 - np.cos(angle)) / angle**2
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + first * cross + second * (cross @ cross)
    moved = turn @ np.ascontiguousarray(pose[:3, :3])
    offset = turn @ (pose[:3, 3] - middle) + middle + change[3:]
    pose[:3, :3], pose[:3, 3] = moved, offset


@numba.njit(cache=True, parallel=True)
def _compute_costs(poses, points, samples, normals, is_open, low, cell_mm, table, diameter_mm, depth_mm, mask, focal):
    costs = np.empty(len(poses))
    kept = max(int(JUDGED_SHARE * len(points)), 1)
    for index in numba.prange(len(poses)):
        pose = poses[index]
        local, normal, place, off = np.empty(3), np.empty(3), np.empty(3), np.empty(len(points))
        for point in range(len(points)):
            _to_model_frame(pose, points[point], local)
            sample = _look_up_nearest(local, low, cell_mm, table)
            _rotate(pose, normals[sample], normal)
            squared, towards = 0.0, 0.0
            for axis in range(3):
                squared += (local[axis] - samples[sample, axis]) ** 2
                towards += normal[axis] * points[point, axis]
            off[point] = np.sqrt(squared) + (AWAY_DIAMETERS * diameter_mm if towards >= 0 and not is_open else 0.0)
        facing, conflicts = 0, 0
        for sample in range(SEEN_SAMPLES):
            _rotate(pose, normals[sample], normal)
            _rotate(pose, samples[sample], place)
            towards = 0.0
            for axis in range(3):
                place[axis] += pose[axis, 3]
                towards += place[axis] * normal[axis]
            if towards >= 0 or place[2] <= 1.0:
                continue
            facing += 1
            column, row = round(focal[0] * place[0] / place[2] + focal[2]), round(focal[1] * place[1] / place[2] + focal[3])
            if 0 <= column < mask.shape[1] and 0 <= row < mask.shape[0] and depth_mm[row, column] > 0:
                behind = place[2] - depth_mm[row, column]
                conflicts += behind < -CONFLICT_MM or (not mask[row, column] and abs(behind) <= CONFLICT_MM)
        costs[index] = np.sort(off)[:kept].mean() / diameter_mm + CONFLICT_DIAMETERS * conflicts / max(facing, 1)
    return costs
