"""Bring a mesh's silhouettes onto the masks by one small offset along its normals.

Surfels have soft edges, and several of them in a row look opaque before the centre of the first one is reached. So the
images are explained best by surfels a fraction of a pixel behind the true surface, by the same amount everywhere. The masks
tell this amount.
"""

import numpy as np
from scipy.ndimage import binary_erosion, distance_transform_edt

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.rendering.training_views import TrainingView

ROUNDS = 2
"""Times that the gap is measured and the mesh moved: the second round sees what the first has left."""
TRIMMED_SHARE = 0.25
"""Share of the contour's gaps that is left out at either end: the open rim on the ground, and parts that are missing."""
SMOOTHING_STEPS = 10
"""Of Taubin's filter, before normals are taken."""


def measure_gap_to_masks(mesh: Mesh, views: list[TrainingView]) -> float:
    """How far the mesh's silhouettes lie inside the masks, in the unit of the mesh; negative where they reach beyond them.

    For each pixel of the silhouettes' contours this is the distance to the mask's edge in pixels, times depth over focal
    length. The result is the trimmed mean over all views.
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
    ordered = np.sort(np.concatenate(gaps))
    ends = int(TRIMMED_SHARE * len(ordered))
    return float(ordered[ends : len(ordered) - ends].mean()) if len(ordered) else 0.0


def fit_to_masks(mesh: Mesh, views: list[TrainingView], limit: float) -> tuple[Mesh, float]:
    """Move a mesh along its vertex normals, by at most `limit`, until its silhouettes meet the masks.

    The normals are those of a smoothed copy, so that moving does not make the surface rougher.

    Returns:
        The moved mesh, and by how much it was moved.
    """
    offset = 0.0
    normals = _smooth_normals(mesh)
    for _ in range(ROUNDS):
        moved = Mesh(mesh.vertices + offset * normals, mesh.faces)
        offset = float(np.clip(offset + measure_gap_to_masks(moved, views), -limit, limit))
    return Mesh(mesh.vertices + offset * normals, mesh.faces), offset


def _smooth_normals(mesh: Mesh) -> np.ndarray:
    surface = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces))
    surface = surface.filter_smooth_taubin(SMOOTHING_STEPS)
    surface.compute_vertex_normals()
    return np.asarray(surface.vertex_normals)
