"""Which photo sees which part of a mesh, and how well."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.imaging.images import sample_bilinear
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

# Set by hand on demo objects: less lets the background into textures, more leaves thin parts without colour.
ERODE_PX = 2.5  # this close to a silhouette or an occlusion edge, a photo may show something else, because the mesh is not exact
MIXED_PX = 1.5  # this close, pixels mix the colours on both sides of the edge
FEATHER_PX = 12.0  # trust grows from 0 to 1 over this distance, so that no seam shows
EDGE_TRUST = 1e-3  # of pixels between MIXED_PX and ERODE_PX: they count where no better photo shows a thin part
SHOWING_COSINE = 0.3  # where it turns away by less (73 degrees), a view shows the colours of a surface well
EDGE_ON_COSINE = 0.05  # where it turns away by more (87 degrees), it is seen edge-on: nothing is divided by less
GRAZING_COSINE = 0.15  # where the surface turns away by more (81 degrees), a view shows and measures nothing of it
DEPTH_STEP_SHARE = 0.01  # of the object's size: a larger step in depth is an occlusion edge
VISIBLE_SHARE = 0.004  # of the object's size: a point this far behind the rendered surface is visible; depth differs within a pixel
SLANT = 1.5  # a step must exceed this many times the change of depth on the pixel's other side, which a slanted plane has, too
OFF_IMAGE = -9.0  # a position that is in no image, in place of one that is not finite


@dataclass(frozen=True)
class ViewMaps:
    """What one photo sees of a mesh.

    Attributes:
        camera: of the photo, or of the part of it that is looked at.
        depth: (height, width) float32 depth of the mesh, 0 where it is not hit.
        trust: (height, width) float32 in [0, 1]: 0 outside the mask and near occlusion edges, growing inwards.
    """

    camera: Camera
    depth: np.ndarray
    trust: np.ndarray


def compute_view_maps(camera: Camera, mask: np.ndarray, depth: np.ndarray, extent: float) -> ViewMaps:
    """Trust each pixel by its distance to the nearest edge, which errors of the geometry could shift.

    Args:
        camera: of the photo, or of a part of it.
        mask: (height, width) bool, True on the object.
        depth: (height, width) float32 of the mesh there, 0 where it is not.
        extent: size of the object in the mesh's unit, the scale for depth steps.
    """
    inner = mask & (depth > 0)
    inner &= ~_find_depth_steps(depth, DEPTH_STEP_SHARE * extent)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    distance = cv2.distanceTransform(inner.astype(np.uint8), cv2.DIST_L2, 5)
    trust = np.clip((distance - ERODE_PX) / FEATHER_PX, 0.0, 1.0)
    trust[(distance > MIXED_PX) & (trust <= 0.0)] = EDGE_TRUST
    return ViewMaps(camera, depth, trust.astype(np.float32))


def rate_vertex_views(mesh: Mesh, maps: list[ViewMaps], extent: float) -> np.ndarray:
    """(V, K) how well view k sees vertex v: trust x cosine^2 x pixels per unit of length, the best being 1; 0 where hidden."""
    quality = np.zeros((len(mesh.vertices), len(maps)), np.float32)
    for k, view in enumerate(maps):
        pixels, depth = view.camera.project(mesh.vertices)
        towards = view.camera.centre_in_world - mesh.vertices
        cosine = np.einsum("ij,ij->i", mesh.vertex_normals, towards) / np.linalg.norm(towards, axis=1)
        seen = find_visible(pixels, depth, view.depth, VISIBLE_SHARE * extent) & (cosine > GRAZING_COSINE)
        trust = sample_image(view.trust, pixels)
        quality[:, k] = seen * trust * cosine**2 * (view.camera.intrinsics[0, 0] / np.maximum(depth, 1e-12))
    return quality / max(float(quality.max()), 1e-30)


def find_visible(pixels: np.ndarray, depth: np.ndarray, depth_map: np.ndarray, tolerance: float) -> np.ndarray:
    """(N,) bool: points at (N, 2) `pixels` and `depth` are not hidden by the mesh.

    A point is hidden if it is behind all four pixels around it by more than `tolerance`.
    """
    height, width = depth_map.shape
    x, y = np.floor(_replace_infinite(pixels) - 0.5).astype(np.int64).T
    inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y = np.clip(x, 0, width - 2), np.clip(y, 0, height - 2)
    farthest = np.max([depth_map[y + j, x + i] for j in (0, 1) for i in (0, 1)], axis=0)
    return inside & (farthest > 0) & (depth <= farthest + tolerance)


def sample_image(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Sample an image at (N, 2) pixel positions (pixel (0, 0)'s centre is (0.5, 0.5)); (N,) or (N, C) float32, 0 off the image."""
    return sample_bilinear(image, _replace_infinite((pixels - 0.5).astype(np.float32)), cv2.BORDER_CONSTANT)


def _replace_infinite(positions: np.ndarray) -> np.ndarray:
    return np.nan_to_num(positions, nan=OFF_IMAGE, posinf=OFF_IMAGE, neginf=OFF_IMAGE)


def _find_depth_steps(depth: np.ndarray, step: float) -> np.ndarray:
    """(height, width) bool: pixels on the far side of an occlusion edge, where a neighbour is nearer by more than a slope explains."""
    filled = np.where(depth > 0, depth, np.float32(depth.max() if depth.size else 0.0) + 10 * step)
    nearest = cv2.erode(filled, np.ones((3, 3), np.uint8))
    farthest = cv2.dilate(filled, np.ones((3, 3), np.uint8))
    return np.maximum(filled - nearest, 0) > step + SLANT * np.minimum(farthest - filled, filled - nearest)
