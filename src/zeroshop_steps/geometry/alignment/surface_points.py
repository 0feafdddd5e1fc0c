"""Points on a mesh, with normals and colours, for alignment to compare."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import sample_texture

PLANE_NEIGHBOURS = 12  # nearest points, which span the plane around a point of a surface
BLUR_SHARE = 0.004  # of the texture's width: print finer than the distance between samples would only be noise


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
    points, faces, weights = sample_surface(mesh, count, rng)
    corners, colors = mesh.faces[faces], None
    if mesh.uv is not None and mesh.texture is not None:
        uv = np.einsum("nc,ncd->nd", weights, mesh.uv[corners])
        blurred = cv2.GaussianBlur(mesh.texture, (0, 0), BLUR_SHARE * mesh.texture.shape[1])
        colors = sample_texture(blurred, uv).astype(np.float64) / 255.0
    elif mesh.colors is not None:
        colors = np.einsum("nc,ncd->nd", weights, mesh.colors[corners] / 255.0)
    return SurfacePoints(points, mesh.face_normals()[faces], colors)
