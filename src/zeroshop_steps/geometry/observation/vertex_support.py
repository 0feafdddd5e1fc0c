"""Classify every vertex of a mesh by what supports it: it was measured, it is assumed, or no photo saw it.

Measured: an outline supports the vertex, or stereo does. An outline does where the surface turns away from the camera at the
border of the photo's mask, since the visual hull touches the object there (Laurentini 1994). The exception is a surface that
continues along the line of sight, such as a lid seen edge-on: the mask then shows its rim only. Stereo does where it confirmed a
depth nearby, if the spot is connected with an outline by other measured vertices; on a plain surface, single depths are confirmed
by chance.

Assumed: two photos or more see the vertex, but only the masks limit it. The lid of a visual hull over a plain hollow, for example,
agrees with every silhouette.

Unseen: fewer than two photos see the vertex, as with a closed underside.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.surface_fields import build_neighbour_matrix, smooth_normals, weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, diameter_of
from zeroshop_steps.geometry.observation.support_classes import ASSUMED, MEASURED, UNSEEN
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE, VISIBLE_SHARE, find_visible, sample_image
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.open3d_loader import o3d

# Lengths in diameters of the mesh. No record says what they were fitted on; tests/evaluate/test_surface_support.py checks them on a cup
# with and without a lid.
NEAR_DIAMETERS = 0.015  # a vertex this close to a confirmed depth is confirmed: 3 mm on an object of 20 cm
EDGE_COSINE = 0.35  # within 20 degrees of edge-on, the surface turns away from the camera
EDGE_DIAMETERS = 0.02  # such a vertex this close to the border of the mask, measured at its depth, lies on the outline
ALONG_DIAMETERS = 0.08  # from the vertex, one point this far towards the camera and one as far behind it are compared with the mesh
VISIBLE_DIAMETERS = 0.01  # a vertex this far behind the rendered depth is still visible; outlines lie where depth changes most


def classify_surface_support(mesh: Mesh, views: Sequence[View], confirmed: np.ndarray, device: str = "cpu") -> np.ndarray:
    """Classify the vertices of `mesh`.

    Args:
        mesh: in the frame of the views' cameras.
        views: registered photos with masks.
        confirmed: (N, 3) points that stereo confirmed, in the same frame.
        device: cpu or cuda, where the mesh is rasterized; the rest is done on the processor.

    Returns:
        (V,) uint8 UNSEEN, ASSUMED or MEASURED.
    """
    joined, index = weld(mesh)
    # Noisy normals would put vertices at random on outlines.
    normals = smooth_normals(joined, build_neighbour_matrix(joined), 3)
    diameter, points, renderer = diameter_of(joined), joined.vertices, MeshRenderer(joined, device)
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
        in_sight = find_visible(pixels, depth, renderer.find_depth(camera), VISIBLE_DIAMETERS * diameter)
        seen += in_sight & (cosine > GRAZING_COSINE)
        mask = view.mask().astype(np.uint8)
        inwards_px = sample_image(cv2.distanceTransform(mask, cv2.DIST_L2, 5), pixels)
        edge_px = EDGE_DIAMETERS * diameter * camera.intrinsics[0, 0] / np.maximum(depth, 1e-12)
        at_edge = np.flatnonzero(in_sight & ~outlined & (np.abs(cosine) < EDGE_COSINE) & (inwards_px < edge_px))
        step = ALONG_DIAMETERS * diameter * towards[at_edge]
        off = [surface.compute_distance(o3d.core.Tensor((points[at_edge] + way).astype(np.float32))).numpy() for way in (step, -step)]
        outlined[at_edge] = np.maximum(*off) > VISIBLE_SHARE * diameter
    measured = _grow_within(outlined, (outlined | confirmed_near) & (seen > 0), joined.faces)
    return np.where(measured, MEASURED, np.where(seen >= AGREEING_VIEWS, ASSUMED, UNSEEN)).astype(np.uint8)[index]


def _grow_within(starts: np.ndarray, within: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) bool: the vertices `within` that edges between such vertices connect with any of `starts`."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[within[edges].all(1)]
    _, part = connected_components(coo_matrix((np.ones(len(edges)), edges.T), shape=(len(within),) * 2), directed=False)
    return within & np.isin(part, part[starts & within])
