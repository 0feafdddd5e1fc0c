"""Tell for every vertex of a mesh what it rests on: measured, assumed, or never seen.

A surface is measured where it turns away from a photo just at the edge of that photo's mask: there the visual hull touches the
object (Laurentini 1994), unless it runs along the line of sight there, like a lid seen edge-on: then its rim alone is what the mask
shows. It is also measured where stereo confirmed it nearby, as far as that hangs together with such an outline: on
a plain surface single spots are confirmed by chance. Elsewhere a hull is only the largest shape that the masks allow: the
lid over a plain hollow agrees with every silhouette. Such a surface is assumed. What fewer than two photos see, like a closed underside,
is unseen.
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

NEAR_DIAMETERS = 0.015
FACING_COSINE = 0.1
EDGE_COSINE = 0.35
EDGE_DIAMETERS = 0.02
ALONG_DIAMETERS, FLAT_DIAMETERS = 0.08, 0.003
VISIBLE_DIAMETERS = 0.01
NORMAL_SMOOTHING = 3
LEAST_VIEWS = 2


def classify_surface_support(mesh: Mesh, views: Sequence[View], confirmed: np.ndarray) -> np.ndarray:
    """(V,) uint8 UNSEEN, ASSUMED or MEASURED.

    Args:
        mesh: in the frame of the views' cameras.
        views: registered photos with masks.
        confirmed: (N, 3) points that stereo confirmed, same frame.
    """
    joined, index = weld(mesh)
    normals = smooth(joined.normals, build_neighbour_matrix(joined), NORMAL_SMOOTHING)
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
        off = [surface.compute_distance(o3d.core.Tensor((points[at_edge] + way).astype(np.float32))).numpy() for way in (step, -step)]
        outlined[at_edge] = np.maximum(*off) > FLAT_DIAMETERS * diameter
    measured = _grow_within(outlined, (outlined | confirmed_near) & (seen > 0), joined.faces)
    return np.where(measured, MEASURED, np.where(seen >= LEAST_VIEWS, ASSUMED, UNSEEN)).astype(np.uint8)[index]


def _grow_within(starts: np.ndarray, within: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) bool, the vertices `within` that hang together with any of `starts` by edges inside of it."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[within[edges].all(1)]
    _, part = connected_components(coo_matrix((np.ones(len(edges)), edges.T), shape=(len(within),) * 2), directed=False)
    return within & np.isin(part, part[starts & within])
