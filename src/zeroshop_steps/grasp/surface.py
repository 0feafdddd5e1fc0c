"""The object's surface as a gripper meets it: dense points with smoothed normals, and rays against the mesh."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import ray_caster

SPACING_M = 0.0025  # between neighbouring points, about: a fifth of a finger's thickness
FEWEST_POINTS, MOST_POINTS = 4000, 30000
SMOOTHING_M = 0.004  # radius within which normals are averaged: a finger's rubber yields to finer relief
SAME_SIDE = 0.3  # least cosine between normals of one side of a wall, or between them and a direction away from the other one


@dataclass(frozen=True)
class GraspSurface:
    """A surface in metres, object frame.

    Attributes:
        points: (P, 3) evenly spread over it.
        normals: (P, 3) outward unit normals, averaged over `SMOOTHING_M`.
        measured: (P,) bool, whether photos measured the surface there.
        assumed: (P,) bool, whether masks alone limit it there: it may be a lid over a hollow.
        tree: of the points.
        caster: rays against the whole mesh.
    """

    points: np.ndarray
    normals: np.ndarray
    measured: np.ndarray
    assumed: np.ndarray
    tree: cKDTree
    caster: Any

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) distances along rays to what they hit first, infinite where nothing, and (N, 3) its outward face normals.

        Args:
            origins: (N, 3) metres.
            directions: (N, 3) unit vectors.
        """
        from zeroshop_steps.runtime.open3d_loader import o3d

        found = self.caster.cast_rays(o3d.core.Tensor(np.concatenate([origins, directions], 1).astype(np.float32)))
        normals: np.ndarray = found["primitive_normals"].numpy().astype(float)
        return found["t_hit"].numpy().astype(float), normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)

    def smooth_normals_at(self, places: np.ndarray, facing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) smoothed normals of the surface at (N, 3) places on it, and (N,) whether it was measured there.

        Args:
            facing: (N, 3) the face normals there, which tell the sides of a thin wall apart.
        """
        _, near = self.tree.query(places, k=min(6, len(self.points)))
        agreement = np.einsum("nkd,nd->nk", self.normals[near], facing)
        best = near[np.arange(len(places)), (agreement > SAME_SIDE).argmax(1)]
        return self.normals[best], self.measured[best]


def make_grasp_surface(mesh: Mesh, rng: np.random.Generator) -> GraspSurface:
    """Sample and index a mesh in metres."""
    count = int(np.clip(mesh.face_areas().sum() / SPACING_M**2 * 2, FEWEST_POINTS, MOST_POINTS))
    points, faces, _ = sample_surface(mesh, count, rng)
    raw = mesh.face_normals()[faces]
    tree = cKDTree(points)
    pairs = tree.query_pairs(SMOOTHING_M, output_type="ndarray")
    pairs = pairs[np.einsum("nd,nd->n", raw[pairs[:, 0]], raw[pairs[:, 1]]) > SAME_SIDE]
    sums = raw.copy()
    for column in range(3):
        sums[:, column] += np.bincount(pairs[:, 0], raw[pairs[:, 1], column], len(points))
        sums[:, column] += np.bincount(pairs[:, 1], raw[pairs[:, 0], column], len(points))
    normals = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    measured, assumed = mesh.measured_faces()[faces], mesh.assumed_faces()[faces]
    return GraspSurface(points, normals, measured, assumed, tree, ray_caster((mesh.vertices, mesh.faces)))
