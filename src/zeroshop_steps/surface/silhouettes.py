"""Bring a mesh's silhouettes onto the masks by one small offset along its normals.

Disks have soft edges, and several of them in a row look opaque before the first one's centre is reached: the images are
explained best by disks a fraction of a pixel behind the true surface, everywhere alike. The masks say by how much.
"""

import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt

from zeroshop_steps.geometry.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.training_views import TrainingView

ROUNDS = 2
TRIM = 0.25
"""Share of the contour that is left out at either end: the open rim on the ground, parts that are missing."""


def measure_gap_to_masks(mesh: Mesh, views: list[TrainingView]) -> float:
    """How far the mesh's silhouettes lie inside the masks, in the unit of the mesh; negative where they reach beyond.

    The trimmed mean, over the contours in all views, of the distance in pixels to the mask's edge, times depth by focal length.
    """
    renderer = MeshRenderer(mesh)
    gaps = []
    for view in views:
        hits = renderer.cast_rays(view.camera)
        silhouette, mask = hits.mask, np.pad(view.mask.numpy() > 0.5, 1)
        contour = silhouette & ~binary_erosion(silhouette, border_value=1)
        # On the mask's own contour the distance to the outside is one.
        inside = (distance_transform_edt(mask) - distance_transform_edt(~mask))[1:-1, 1:-1] - np.where(view.mask.numpy() > 0.5, 1.0, 0.0)
        gaps.append(inside[contour] * hits.depth[contour] / view.camera.intrinsics[0, 0])
    gaps = np.sort(np.concatenate(gaps))
    ends = int(TRIM * len(gaps))
    return float(gaps[ends : len(gaps) - ends].mean()) if len(gaps) else 0.0


def fit_to_masks(mesh: Mesh, views: list[TrainingView], limit: float) -> tuple[Mesh, float]:
    """The mesh moved along its vertex normals until its silhouettes meet the masks, by at most `limit`; and by how much.

    Normals are those of a smoothed copy, so that roughness is carried along rather than enlarged.
    """
    offset = 0.0
    normals = _smooth_normals(mesh)
    for _ in range(ROUNDS):
        moved = Mesh(mesh.vertices + offset * normals, mesh.faces)
        offset = float(np.clip(offset + measure_gap_to_masks(moved, views), -limit, limit))
    return Mesh(mesh.vertices + offset * normals, mesh.faces), offset


def _smooth_normals(mesh: Mesh) -> np.ndarray:
    surface = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces))
    surface = surface.filter_smooth_taubin(10)
    surface.compute_vertex_normals()
    return np.asarray(surface.vertex_normals)
