"""Which photo sees which part of the surface, and how well."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.mesh_rendering import RayHits
from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.registered_views import View

ERODE_PX = 2.5  # this close to a silhouette or an occlusion edge a photo may show something else
MIXED_PX = 1.5  # this close, pixels mix what lies on both sides of the edge
FEATHER_PX = 12.0  # trust grows back over this distance
VISIBLE_SHARE = 0.004  # of the object's size: a point this far behind the rendered surface is visible; depth differs within a pixel
MIN_COSINE = 0.15  # more grazing views are not used


@dataclass(frozen=True)
class ViewMaps:
    """A photo prepared for look-ups.

    Attributes:
        camera: its camera.
        depth: (height, width) float32 depth of the mesh, 0 where it is not hit.
        trust: (height, width) float32 in [0, 1]: 0 outside the mask and near occlusion edges, growing inwards.
    """

    camera: Camera
    depth: np.ndarray
    trust: np.ndarray


def compute_view_maps(view: View, hits: RayHits, extent: float) -> ViewMaps:
    """Measure each pixel's distance to the nearest edge that geometry errors could shift.

    Args:
        view: the photo.
        hits: what its pixels see of the mesh.
        extent: size of the object in the same unit, the scale for depth steps.
    """
    inner = view.mask() & hits.mask
    inner &= ~_find_depth_steps(hits.depth, 0.01 * extent)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    distance = cv2.distanceTransform(inner.astype(np.uint8), cv2.DIST_L2, 5)
    trust = np.clip((distance - ERODE_PX) / FEATHER_PX, 0.0, 1.0)
    trust[(distance > MIXED_PX) & (trust <= 0.0)] = 1e-3  # thin parts are all edge: better than no colour
    return ViewMaps(view.camera, hits.depth, trust.astype(np.float32))


def rate_vertex_views(mesh: Mesh, maps: list[ViewMaps], extent: float) -> np.ndarray:
    """(V, K) how well view k sees vertex v: trust x cosine^2 x sharpness (pixels a unit length, best view = 1); 0 where hidden."""
    quality = np.zeros((len(mesh.vertices), len(maps)), np.float32)
    for k, view in enumerate(maps):
        pixels, depth = view.camera.project(mesh.vertices)
        towards = view.camera.centre_in_world - mesh.vertices
        cosine = np.einsum("ij,ij->i", mesh.normals, towards) / np.linalg.norm(towards, axis=1)
        seen = find_visible(pixels, depth, view.depth, VISIBLE_SHARE * extent) & (cosine > MIN_COSINE)
        trust = sample_image(view.trust, pixels)
        quality[:, k] = seen * trust * cosine**2 * (view.camera.intrinsics[0, 0] / np.maximum(depth, 1e-12))
    return quality / max(float(quality.max()), 1e-30)


def find_visible(pixels: np.ndarray, depth: np.ndarray, depth_map: np.ndarray, tolerance: float) -> np.ndarray:
    """(N,) bool: points at (N, 2) `pixels` and `depth` are at no neighbouring pixel behind the mesh by more than `tolerance`."""
    height, width = depth_map.shape
    x, y = np.floor(np.nan_to_num(pixels, nan=-9.0, posinf=-9.0, neginf=-9.0) - 0.5).astype(np.int64).T
    inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y = np.clip(x, 0, width - 2), np.clip(y, 0, height - 2)
    farthest = np.max([depth_map[y + j, x + i] for j in (0, 1) for i in (0, 1)], axis=0)
    return inside & (farthest > 0) & (depth <= farthest + tolerance)


def sample_image(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Bilinear look-up at (N, 2) pixel positions (pixel (0, 0)'s centre is (0.5, 0.5)); (N,) or (N, C) float32, 0 outside."""
    rows = max(1, -(-len(pixels) // 16384))
    padded = np.full((2, rows * 16384), -9.0, np.float32)
    padded[:, : len(pixels)] = (pixels - 0.5).T
    map_x, map_y = np.nan_to_num(padded, nan=-9.0, posinf=-9.0, neginf=-9.0).reshape(2, rows, 16384)
    sampled = cv2.remap(image.astype(np.float32), map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return sampled.reshape((rows * 16384,) + image.shape[2:])[: len(pixels)]


def _find_depth_steps(depth: np.ndarray, step: float) -> np.ndarray:
    """(height, width) bool: the pixel is on the far side of an occlusion edge: a neighbour is nearer by more than a slope explains."""
    filled = np.where(depth > 0, depth, np.float32(depth.max() if depth.size else 0.0) + 10 * step)
    nearest = cv2.erode(filled, np.ones((3, 3), np.uint8))
    # a slanted plane changes evenly: compare with the change on the other side
    farthest = cv2.dilate(filled, np.ones((3, 3), np.uint8))
    return np.maximum(filled - nearest, 0) > step + 1.5 * np.minimum(farthest - filled, filled - nearest)
