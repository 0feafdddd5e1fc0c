"""Points on a mesh, with normals and colours, for alignment to compare."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import sample_texture

BLUR_SHARE = 0.004  # of the texture's width: print finer than the distance between samples would only be noise
LEAST_BLUR_PX = 0.5  # of a small texture


@dataclass(frozen=True)
class SurfacePoints:
    """Samples of a surface.

    Attributes:
        points: (N, 3) positions.
        normals: (N, 3) unit, outwards.
        colors: (N, 3) 0..1 in the texture's encoding, or None without a texture and without colours at the vertices.
    """

    points: np.ndarray
    normals: np.ndarray
    colors: np.ndarray | None

    def part(self, count: int) -> "SurfacePoints":
        """The first `count` samples, which are as evenly distributed as all of them."""
        return SurfacePoints(self.points[:count], self.normals[:count], None if self.colors is None else self.colors[:count])


def sample_surface_points(mesh: Mesh, count: int, rng: np.random.Generator) -> SurfacePoints:
    """Sample a mesh at random, evenly by area."""
    points, faces = sample_surface(mesh, count, rng)
    colors = None
    if mesh.uv is not None and mesh.texture is not None:
        corners = mesh.faces[faces]
        uv = np.einsum("nc,ncd->nd", _barycentric(points, mesh.vertices[corners]), mesh.uv[corners])
        blurred = cv2.GaussianBlur(mesh.texture, (0, 0), max(BLUR_SHARE * mesh.texture.shape[1], LEAST_BLUR_PX))
        colors = sample_texture(blurred, uv).astype(np.float64) / 255.0
    elif mesh.colors is not None:
        corners = mesh.faces[faces]
        colors = np.einsum("nc,ncd->nd", _barycentric(points, mesh.vertices[corners]), mesh.colors[corners] / 255.0)
    return SurfacePoints(points, mesh.face_normals()[faces], colors)


def _barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N, 3) weights of the corners (N, 3, 3) of a triangle at (N, 3) points in it."""
    along, across, place = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    d11, d12, d22 = (along**2).sum(1), (along * across).sum(1), (across**2).sum(1)
    p1, p2 = (place * along).sum(1), (place * across).sum(1)
    scale = np.maximum(d11 * d22 - d12**2, 1e-30)
    second, third = (d22 * p1 - d12 * p2) / scale, (d11 * p2 - d12 * p1) / scale
    return np.stack([1 - second - third, second, third], 1)
