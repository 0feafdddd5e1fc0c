"""Poses from many rotations at once: measured points iterated onto the model's surface, the worse ones given up on the way."""

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop.surface_points import SurfacePoints, surface_points
from zeroshop_steps.detect.templates import view_directions
from zeroshop_steps.meshes import Mesh

VIEWS, TURNS = 42, 12
SAMPLES = 4000
FIRST_POINTS, LAST_POINTS, FINAL_POINTS = 60, 150, 600
FIRST_STEPS, LAST_STEPS, FINAL_STEPS = 8, 12, 12
KEPT = 72
NEAR_SHARE = 0.85
SEEN_SAMPLES = 400
CONFLICT_MM = 12.0
CONFLICT_WEIGHT = 0.5


class PoseSearch:
    """One model, ready to be found."""

    def __init__(self, mesh: Mesh, diameter_mm: float) -> None:
        self._surface: SurfacePoints = surface_points(mesh, SAMPLES, np.random.default_rng(0))
        self._tree = cKDTree(self._surface.points)
        self._diameter_mm = diameter_mm
        turns = Rotation.from_euler("z", np.arange(TURNS)[:, None] * 2 * np.pi / TURNS)
        self._rotations = np.concatenate([(turns * Rotation.from_matrix(_towards(view))).as_matrix() for view in view_directions(VIEWS)])

    def search(self, points: np.ndarray, depth_mm: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
        """(KEPT, 4, 4) camera_from_model in mm, the best first, by shape alone.

        Args:
            points: (N, 3) measured points on the object, camera frame, mm, in random order.
            depth_mm: (height, width) measured depth of the scene.
            mask: (height, width) bool, the object's visible pixels.
            intrinsics: (3, 3) BOP's K.
        """
        poses = self._starts(points)
        for _ in range(FIRST_STEPS):
            poses = self._step(poses, points[:FIRST_POINTS])
        costs = self._costs(poses, points[:FIRST_POINTS], depth_mm, mask, intrinsics)
        poses = poses[np.argsort(costs, kind="stable")[:KEPT]]
        for _ in range(LAST_STEPS):
            poses = self._step(poses, points[:LAST_POINTS])
        return poses[np.argsort(self._costs(poses, points[:LAST_POINTS], depth_mm, mask, intrinsics), kind="stable")]

    def refined(self, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(4, 4) camera_from_model after further steps on more points."""
        for _ in range(FINAL_STEPS):
            pose = self._step(pose[None], points[:FINAL_POINTS])[0]
        return pose

    def _starts(self, points: np.ndarray) -> np.ndarray:
        """Every rotation, the middle of the surface that then faces the camera put onto the middle of the measured points."""
        middle = np.median(points, axis=0)
        away = middle / np.linalg.norm(middle)
        facing = self._surface.normals @ self._rotations.transpose(0, 2, 1) @ away < 0
        turned = self._surface.points @ self._rotations.transpose(0, 2, 1)
        centres = (turned * facing[..., None]).sum(1) / facing.sum(1)[:, None]
        poses = np.tile(np.eye(4), (len(self._rotations), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = self._rotations, middle - centres
        return poses

    def _match(self, poses: np.ndarray, points: np.ndarray):
        """Nearest samples of the model, how far each point is off along their normals, and whether they face the camera."""
        local = (points - poses[:, None, :3, 3]) @ poses[:, :3, :3]
        distance, nearest = (found.reshape(local.shape[:2]) for found in self._tree.query(local.reshape(-1, 3)))
        normals = self._surface.normals[nearest] @ poses[:, :3, :3].transpose(0, 2, 1)
        targets = self._surface.points[nearest] @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        faces = np.einsum("cni,ni->cn", normals, points) < 0
        return distance, normals, targets, faces

    def _step(self, poses: np.ndarray, points: np.ndarray) -> np.ndarray:
        """One step of point-to-plane ICP (Chen and Medioni 1991) that moves the models towards the points."""
        distance, normals, targets, faces = self._match(poses, points)
        weights = (distance <= np.quantile(distance, NEAR_SHARE, axis=1, keepdims=True)) & faces
        middle = points.mean(0)
        gaps = np.einsum("cni,cni->cn", points - targets, normals)
        rows = np.concatenate([np.cross(targets - middle, normals), normals], 2)
        normal = np.einsum("cni,cnj,cn->cij", rows, rows, weights.astype(float), optimize=True)
        right = np.einsum("cni,cn,cn->ci", rows, gaps, weights.astype(float), optimize=True)
        damping = 1e-3 * np.einsum("cii->ci", normal)[..., None] * np.eye(6) + 1e-6 * np.eye(6)
        change = np.linalg.solve(normal + damping, right[..., None])[..., 0]
        turn = Rotation.from_rotvec(np.clip(change[:, :3], -0.4, 0.4)).as_matrix()
        moved = poses.copy()
        moved[:, :3, :3] = turn @ poses[:, :3, :3]
        moved[:, :3, 3] = np.einsum("cij,cj->ci", turn, poses[:, :3, 3] - middle) + middle + change[:, 3:]
        return moved

    def _costs(self, poses: np.ndarray, points: np.ndarray, depth_mm: np.ndarray, mask: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
        """Mean distance of the nearer points in diameters, and the share of the facing surface that the image contradicts."""
        distance, _, _, faces = self._match(poses, points)
        off = np.where(faces, distance, distance + 0.05 * self._diameter_mm)
        near = np.sort(off, axis=1)[:, : int(0.95 * len(points))].mean(1) / self._diameter_mm
        samples = self._surface.points[:SEEN_SAMPLES] @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        normals = self._surface.normals[:SEEN_SAMPLES] @ poses[:, :3, :3].transpose(0, 2, 1)
        facing = (np.einsum("cni,cni->cn", samples, normals) < 0) & (samples[..., 2] > 1)
        projected = samples @ intrinsics.T
        pixels = np.rint(projected[..., :2] / np.maximum(projected[..., 2:], 1.0)).astype(int)
        height, width = depth_mm.shape
        inside = (pixels >= 0).all(-1) & (pixels < [width, height]).all(-1) & facing
        columns, rows = np.clip(pixels[..., 0], 0, width - 1), np.clip(pixels[..., 1], 0, height - 1)
        there, on = depth_mm[rows, columns], mask[rows, columns]
        before = (there > 0) & (samples[..., 2] < there - CONFLICT_MM)
        beside = (there > 0) & ~on & (np.abs(samples[..., 2] - there) <= CONFLICT_MM)
        conflict = (inside & (before | beside)).sum(1) / np.maximum(facing.sum(1), 1)
        return near + CONFLICT_WEIGHT * conflict * 0.2


def _towards(view: np.ndarray) -> np.ndarray:
    """(3, 3) camera_from_model of a camera that looks from the direction `view` (3,)."""
    forward = -view
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])
