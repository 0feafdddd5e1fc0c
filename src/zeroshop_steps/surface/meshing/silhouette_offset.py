"""Bring a mesh's silhouettes onto the masks by one small offset along its normals.

Surfels have soft edges, and several of them in a row look opaque before the centre of the first one is reached. So the
images are explained best by surfels a fraction of a pixel behind the true surface, by the same amount everywhere. The masks
tell this amount.
"""

import cv2
import numpy as np

from zeroshop_steps.geometry.meshes.meshlab import VOXEL_STEPS, from_meshlab, smooth_taubin, to_meshlab
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.surface.rendering.training_views import TrainingView

ROUNDS = 2
"""Times that the gap is measured and the mesh moved: the second round sees what the first has left."""
TRIMMED_SHARE = 0.25
"""Share of the contour's gaps that is left out at either end: the open rim on the ground, and parts that are missing."""
CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


def measure_gap_to_masks(mesh: Mesh, views: list[TrainingView], inside_px: list[np.ndarray]) -> float:
    """How far the mesh's silhouettes lie inside the masks, in the unit of the mesh; negative where they reach beyond them.

    For each pixel of the silhouettes' contours this is the distance to the mask's edge in pixels, times depth over focal
    length. The result is the trimmed mean over all views.

    Args:
        inside_px: of each view, what `measure_inside` returns.
    """
    renderer = MeshRenderer(mesh)
    gaps = []
    for view, inside in zip(views, inside_px, strict=True):
        depth = renderer.find_depth(view.camera)
        silhouette = (depth > 0).astype(np.uint8)
        contour = silhouette > cv2.erode(silhouette, CROSS, borderType=cv2.BORDER_CONSTANT, borderValue=1)
        gaps.append(inside[contour] * depth[contour] / view.camera.intrinsics[0, 0])
    ordered = np.sort(np.concatenate(gaps))  # as SciPy's trim_mean, whose module takes 0.3 s to import
    ends = int(TRIMMED_SHARE * len(ordered))
    return float(ordered[ends : len(ordered) - ends].mean()) if len(ordered) else 0.0


def measure_inside(mask: np.ndarray) -> np.ndarray:
    """(H, W) float32 distance of each pixel to a mask's contour: 0 on it, positive inside, and at least 1 outside, with a minus."""
    padded = np.pad(mask, 1).astype(np.uint8)
    within, beyond = (cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] for part in (padded, 1 - padded))
    return np.where(mask, within - 1, -beyond)


def fit_to_masks(mesh: Mesh, views: list[TrainingView], limit: float) -> tuple[Mesh, float]:
    """Move a mesh along its vertex normals, by at most `limit`, until its silhouettes meet the masks.

    The normals are those of a smoothed copy, so that moving does not make the surface rougher.

    Returns:
        The moved mesh, and by how much it was moved.
    """
    offset = 0.0
    inside_px = map_in_threads(lambda view: measure_inside(view.mask.numpy() > 0.5), views)
    smoothed = to_meshlab(mesh)
    smooth_taubin(smoothed, VOXEL_STEPS)
    normals = from_meshlab(smoothed).vertex_normals
    for _ in range(ROUNDS):
        moved = Mesh(mesh.vertices + offset * normals, mesh.faces)
        offset = float(np.clip(offset + measure_gap_to_masks(moved, views, inside_px), -limit, limit))
    return Mesh(mesh.vertices + offset * normals, mesh.faces), offset
