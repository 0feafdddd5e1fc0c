"""Point-to-plane ICP of many poses of one model at once, and their costs by shape.

The constants here were chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and
poses"). Images that figures are published of were not used.
"""

import numba
import numpy as np

from zeroshop_steps.geometry.alignment.similarity_search import NEAR_SHARE
from zeroshop_steps.geometry.cameras.pinhole import NEAREST_MM
from zeroshop_steps.geometry.cholesky import solve_by_cholesky
from zeroshop_steps.pose.nearest_surface import NearestSurface

LARGEST_TURN = 0.4  # radians about each axis in one step (23 degrees); the linearised rotation is worthless beyond
DAMPING = 1e-3  # of the diagonal of the normal equations (Levenberg-Marquardt); keeps a step small where the points do not fix it
SMALL_ANGLE = 1e-4  # radians below which sine and cosine are replaced by their series: their quotients would lose all digits
COSTED_SHARE = 0.95  # of the points, the nearest, whose mean distance is the cost; more than in a step, so that wrong poses pay
AWAY_DIAMETERS = 0.05  # added to the distance of a point whose nearest surface faces away from the camera, which cannot see it
SEEN_SAMPLES = 400  # points of the model that are compared with the depth image; about half of them face the camera
CONFLICT_MM = 12.0  # the image contradicts a point that lies farther than this in front of the measured depth, since it would hide it,
# and a point outside the mask that lies within this distance of it, since it would be seen there
CONFLICT_DIAMETERS = 0.1  # cost of a pose whose facing points are all contradicted; if a tenth of them are, 1 % of the diameter


def run_icp(poses: np.ndarray, points: np.ndarray, surface: NearestSurface, steps: int) -> np.ndarray:
    """Move poses towards measured points by point-to-plane ICP (Chen and Medioni 1991).

    The farthest points are ignored, and so are those whose nearest surface faces away from the camera, unless the model may be hollow.

    Args:
        poses: (P, 4, 4) camera_from_model, mm.
        points: (N, 3) measured points, camera frame, mm.
        surface: of the model.
        steps: of ICP.

    Returns:
        (P, 4, 4) camera_from_model.
    """
    moved = np.ascontiguousarray(poses, np.float64).copy()
    _run_icp(moved, np.ascontiguousarray(points, np.float64), points.mean(0), surface, steps)
    return moved


def compute_shape_costs(
    poses: np.ndarray, points: np.ndarray, surface: NearestSurface, diameter_mm: float, depth_mm: np.ndarray, mask: np.ndarray,
    intrinsics: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(P,) costs: mean distance of the nearer points in diameters, plus a share for what the depth image contradicts.

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
    focal = np.array([intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]], np.float64)
    return _compute_costs(poses, points, surface, float(diameter_mm), depth_mm, mask, focal)


@numba.njit(cache=True, forceinline=True)
def _to_model_frame(pose: np.ndarray, point: np.ndarray, out: np.ndarray) -> None:
    """Write a point of the camera's frame in the model's frame to `out`."""
    for axis in range(3):
        out[axis] = 0.0
        for row in range(3):
            out[axis] += pose[row, axis] * (point[row] - pose[row, 3])


@numba.njit(cache=True, forceinline=True)
def _look_up_nearest(local: np.ndarray, surface: NearestSurface) -> int:
    """Index of the sample nearest to a point in the model's frame, by the table."""
    low, cell_mm, table = surface.low, surface.cell_mm, surface.table
    x = min(max(int((local[0] - low[0]) / cell_mm), 0), table.shape[0] - 1)
    y = min(max(int((local[1] - low[1]) / cell_mm), 0), table.shape[1] - 1)
    z = min(max(int((local[2] - low[2]) / cell_mm), 0), table.shape[2] - 1)
    return table[x, y, z]


@numba.njit(cache=True, forceinline=True)
def _rotate(pose: np.ndarray, vector: np.ndarray, out: np.ndarray) -> None:
    """Write a direction of the model's frame in the camera's frame to `out`."""
    for row in range(3):
        out[row] = pose[row, 0] * vector[0] + pose[row, 1] * vector[1] + pose[row, 2] * vector[2]


@numba.njit(cache=True, parallel=True)
def _run_icp(poses: np.ndarray, points: np.ndarray, middle: np.ndarray, surface: NearestSurface, steps: int) -> None:
    """`run_icp` in place."""
    for index in numba.prange(len(poses)):
        _move_pose(poses[index], points, middle, surface, steps)


# Loops in place of numpy's products and solver: numba compiles all that a parallel loop calls several times, for most of a minute.
@numba.njit(cache=True, forceinline=True)
def _move_pose(pose: np.ndarray, points: np.ndarray, middle: np.ndarray, surface: NearestSurface, steps: int) -> None:
    """The steps of one pose, in place."""
    distances, faces = np.empty(len(points)), np.empty(len(points), np.bool_)
    rows, gaps = np.empty((len(points), 6)), np.empty(len(points))
    for _ in range(steps):
        _build_equations(pose, points, middle, surface, distances, faces, rows, gaps)
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
        solve_by_cholesky(square, right)
        _apply_step(pose, right, middle)


@numba.njit(cache=True, forceinline=True)
def _build_equations(
    pose: np.ndarray, points: np.ndarray, middle: np.ndarray, surface: NearestSurface, distances: np.ndarray, faces: np.ndarray,
    rows: np.ndarray, gaps: np.ndarray,
) -> None:  # fmt: skip
    """Fill in for each point: its distance, whether the nearest surface faces the camera, and its row and gap of the least squares."""
    local, normal, target = np.empty(3), np.empty(3), np.empty(3)
    for point in range(len(points)):
        _to_model_frame(pose, points[point], local)
        sample = _look_up_nearest(local, surface)
        _rotate(pose, surface.normals[sample], normal)
        _rotate(pose, surface.points[sample], target)
        squared, towards, gap = 0.0, 0.0, 0.0
        for axis in range(3):
            squared += (local[axis] - surface.points[sample, axis]) ** 2
            towards += normal[axis] * points[point, axis]
            target[axis] += pose[axis, 3]
            gap += (points[point, axis] - target[axis]) * normal[axis]
            rows[point, 3 + axis] = normal[axis]
        distances[point], faces[point], gaps[point] = np.sqrt(squared), surface.is_open or towards < 0, gap
        for axis in range(3):
            after, last = (axis + 1) % 3, (axis + 2) % 3
            rows[point, axis] = (target[after] - middle[after]) * normal[last] - (target[last] - middle[last]) * normal[after]


@numba.njit(cache=True, forceinline=True)
def _apply_step(pose: np.ndarray, change: np.ndarray, middle: np.ndarray) -> None:
    """Rotate a pose about `middle` by the rotation vector change[:3] and translate it by change[3:], in place."""
    vector, squared = np.empty(3), 0.0
    for axis in range(3):
        vector[axis] = min(max(change[axis], -LARGEST_TURN), LARGEST_TURN)
        squared += vector[axis] ** 2
    angle = np.sqrt(squared)
    first = 1.0 - squared / 6 if angle < SMALL_ANGLE else np.sin(angle) / angle
    second = 0.5 - squared / 24 if angle < SMALL_ANGLE else (1.0 - np.cos(angle)) / squared
    turned = np.empty(3)
    for column in range(4):
        # The translation is turned about the middle, the axes are turned as they are.
        for row in range(3):
            turned[row] = pose[row, column] - (middle[row] if column == 3 else 0.0)
        along = vector[0] * turned[0] + vector[1] * turned[1] + vector[2] * turned[2]
        for row in range(3):
            after, last = (row + 1) % 3, (row + 2) % 3
            cross = vector[after] * turned[last] - vector[last] * turned[after]
            moved = turned[row] + first * cross + second * (vector[row] * along - squared * turned[row])  # Rodrigues' formula
            pose[row, column] = moved + (middle[row] + change[3 + row] if column == 3 else 0.0)


@numba.njit(cache=True, parallel=True)
def _compute_costs(
    poses: np.ndarray, points: np.ndarray, surface: NearestSurface, diameter_mm: float, depth_mm: np.ndarray, mask: np.ndarray,
    focal: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """`compute_shape_costs`; `focal` is fx, fy, cx, cy."""
    costs = np.empty(len(poses))
    kept = max(int(COSTED_SHARE * len(points)), 1)
    for index in numba.prange(len(poses)):
        pose = poses[index]
        local, normal, place, off = np.empty(3), np.empty(3), np.empty(3), np.empty(len(points))
        for point in range(len(points)):
            _to_model_frame(pose, points[point], local)
            sample = _look_up_nearest(local, surface)
            _rotate(pose, surface.normals[sample], normal)
            squared, towards = 0.0, 0.0
            for axis in range(3):
                squared += (local[axis] - surface.points[sample, axis]) ** 2
                towards += normal[axis] * points[point, axis]
            off[point] = np.sqrt(squared) + (AWAY_DIAMETERS * diameter_mm if towards >= 0 and not surface.is_open else 0.0)
        facing, conflicts = 0, 0
        for sample in range(SEEN_SAMPLES):
            _rotate(pose, surface.normals[sample], normal)
            _rotate(pose, surface.points[sample], place)
            towards = 0.0
            for axis in range(3):
                place[axis] += pose[axis, 3]
                towards += place[axis] * normal[axis]
            if towards >= 0 or place[2] <= NEAREST_MM:
                continue
            facing += 1
            column, row = round(focal[0] * place[0] / place[2] + focal[2]), round(focal[1] * place[1] / place[2] + focal[3])
            if 0 <= column < mask.shape[1] and 0 <= row < mask.shape[0] and depth_mm[row, column] > 0:
                behind = place[2] - depth_mm[row, column]
                conflicts += behind < -CONFLICT_MM or (not mask[row, column] and abs(behind) <= CONFLICT_MM)
        costs[index] = np.sort(off)[:kept].mean() / diameter_mm + CONFLICT_DIAMETERS * conflicts / max(facing, 1)
    return costs
