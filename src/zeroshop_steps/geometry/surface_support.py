"""Classify every vertex of a mesh as measured, assumed or unseen.

Measured is a surface that an outline or stereo determines:

- By an outline: the surface turns away from a photo at the edge of its mask, where the visual hull touches the object (Laurentini
  1994). It does not count where the surface runs along the line of sight, like a lid seen edge-on: only its rim is an outline.
- By stereo: a confirmed point lies nearby, and measured surface connects it with an outline. On plain surfaces, stereo confirms
  single points by chance.

Assumed is other surface that two photos see. There, the hull is only the largest shape that the masks allow: a lid over a plain
hollow agrees with every silhouette. Unseen is the rest, such as a closed underside.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.mesh_rendering import MeshRenderer
from zeroshop_steps.geometry.meshes import Mesh, diameter_of
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.support_classes import ASSUMED, MEASURED, UNSEEN
from zeroshop_steps.geometry.surface_fields import build_neighbour_matrix, smooth, weld
from zeroshop_steps.geometry.visibility import find_visible, sample_image
from zeroshop_steps.runtime.open3d_loader import o3d

# Lengths are shares of the object's diameter. All were set by hand on demo and YCB-V objects with and without plain hollows; the
# grades that they lead to were compared with the truth in 284 cells (docs/results.md).
NEAR_DIAMETERS = 0.015  # a vertex is confirmed by stereo within this distance of a confirmed point
FACING_COSINE = 0.1  # a photo that sees the surface at a flatter angle (less than 6 degrees) does not count as seeing it
EDGE_COSINE = 0.35  # an outline is where the surface is at most 20 degrees from the line of sight ...
EDGE_DIAMETERS = 0.02  # ... and its projection at most this far inside the mask: the mesh is no closer to the object
# The surface runs along the line of sight where, one such step away along it in either direction, it is still this close.
ALONG_DIAMETERS, FLAT_DIAMETERS = 0.08, 0.003
VISIBLE_DIAMETERS = 0.01  # a vertex may lie this far behind the depth map, for errors of the smoothed mesh
NORMAL_SMOOTHING = 3  # rounds over the neighbours; normals of a raw mesh are noisy
LEAST_VIEWS = 2


def classify_surface_support(mesh: Mesh, views: Sequence[View], confirmed: np.ndarray) -> np.ndarray:
    """(V,) uint8: UNSEEN, ASSUMED or MEASURED for each vertex.

    Args:
        mesh: in the frame of the views' cameras.
        views: registered photos with masks.
        confirmed: (N, 3) points that stereo confirmed, in the same frame.
    """
    joined, index = weld(mesh)
    normals = smooth(joined.vertex_normals, build_neighbour_matrix(joined), NORMAL_SMOOTHING)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    diameter, points, renderer = diameter_of(joined), joined.vertices, MeshRenderer(joined)
    outlined, confirmed_near = np.zeros(len(points), bool), np.zeros(len(points), bool)
    if len(confirmed):
        confirmed_near = cKDTree(confirmed).query(points)[0] < NEAR_DIAMETERS * diameter
    surface = renderer.scene
    seen = np.zeros(len(points), np.int64)
    for view in views:
        camera = view.camera
        pixels, depth = camera.project(points)
        towards = camera.centre_in_world - points
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = np.einsum("ij,ij->i", normals, towards)
        in_sight = find_visible(pixels, depth, renderer.cast_rays(camera).depth, VISIBLE_DIAMETERS * diameter)
        seen += in_sight & (cosine > FACING_COSINE)
        mask = view.mask().astype(np.uint8)
        inwards_px = sample_image(cv2.distanceTransform(mask, cv2.DIST_L2, 5), pixels)
        edge_px = EDGE_DIAMETERS * diameter * camera.intrinsics[0, 0] / np.maximum(depth, 1e-12)
        at_edge = np.flatnonzero(in_sight & ~outlined & (np.abs(cosine) < EDGE_COSINE) & (inwards_px < edge_px))
        step = ALONG_DIAMETERS * diameter * towards[at_edge]
        moved = [points[at_edge] + step, points[at_edge] - step]
        off = [surface.compute_distance(o3d.core.Tensor(places.astype(np.float32))).numpy() for places in moved]
        outlined[at_edge] = np.maximum(*off) > FLAT_DIAMETERS * diameter
    measured = _grow_within(outlined, (outlined | confirmed_near) & (seen > 0), joined.faces)
    return np.where(measured, MEASURED, np.where(seen >= LEAST_VIEWS, ASSUMED, UNSEEN)).astype(np.uint8)[index]


def _grow_within(starts: np.ndarray, within: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) bool: the vertices of `within` that are connected to any of `starts` by edges between vertices of `within`."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[within[edges].all(1)]
    _, part = connected_components(coo_matrix((np.ones(len(edges)), edges.T), shape=(len(within),) * 2), directed=False)
    return within & np.isin(part, part[starts & within])
