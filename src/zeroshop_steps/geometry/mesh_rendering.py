"""Render a mesh by ray casting: depth, mask, surface coordinates and unlit colour."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.images import sample_bilinear
from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

PLAIN_GREY = 190.0  # of 255, of a mesh without texture
# Shaded renders, of 255: faces seen edge-on, what facing the camera adds, and the same for faces seen from behind, which are tinted red.
DARKEST, FACING_GAIN = 40.0, 190.0
BACK_DARKEST, BACK_GAIN = 60.0, 120.0
BACK_TINT = (1.0, 0.4, 0.4)


@dataclass(frozen=True)
class RayHits:
    """What the rays through the pixel centres hit first.

    Attributes:
        face: (height, width) int64 face index, -1 where nothing is hit.
        barycentric: (height, width, 2) weights of the face's second and third corner.
        depth: (height, width) float32 depth along the optical axis in the mesh's unit, 0 where nothing is hit.
    """

    face: np.ndarray
    barycentric: np.ndarray
    depth: np.ndarray

    @property
    def mask(self) -> np.ndarray:
        """(height, width) bool, True where the mesh is hit."""
        return self.face >= 0


class MeshRenderer:
    """Casts rays at one mesh. Building it takes time, so one serves all views."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.scene = ray_caster((mesh.vertices, mesh.faces))

    def cast_rays(self, camera: Camera) -> RayHits:
        """Cast one ray through each pixel centre of `camera`; pixels far from the mesh are skipped."""
        shape = (camera.height_px, camera.width_px)
        face, depth = np.full(shape, -1, np.int64), np.zeros(shape, np.float32)
        barycentric = np.zeros((*shape, 2), np.float32)
        window, cropped = self._around_mesh(camera)
        if face[window].size:
            k, pose = o3d.core.Tensor(cropped.intrinsics), o3d.core.Tensor(cropped.camera_from_world)
            # These rays have unit depth along the optical axis, so t_hit is the depth.
            rays = o3d.t.geometry.RaycastingScene.create_rays_pinhole(k, pose, cropped.width_px, cropped.height_px)
            found = self.scene.cast_rays(rays)
            distance = found["t_hit"].numpy()
            hit = np.isfinite(distance)
            face[window] = np.where(hit, found["primitive_ids"].numpy().astype(np.int64), -1)
            depth[window] = np.where(hit, distance, 0.0)
            barycentric[window] = found["primitive_uvs"].numpy()
        return RayHits(face, barycentric, depth)

    def _around_mesh(self, camera: Camera) -> tuple[tuple[slice, slice], Camera]:
        """Rows and columns of the pixels that may see the mesh, and the camera of these pixels alone."""
        pixels, depths = camera.project(self.mesh.vertices)
        size = np.array([camera.width_px, camera.height_px])
        first, last = np.zeros(2, int), size
        if len(depths) and (depths > 0).all():
            first = np.clip(np.floor(pixels.min(0)) - 1, 0, size).astype(int)
            last = np.clip(np.ceil(pixels.max(0)) + 1, first, size).astype(int)
        intrinsics = camera.intrinsics.copy()
        intrinsics[:2, 2] -= first
        width_px, height_px = (last - first).tolist()
        window = (slice(first[1], last[1]), slice(first[0], last[0]))
        return window, Camera(camera.name, width_px, height_px, intrinsics, camera.camera_from_world)

    def render_color(self, camera: Camera, background: tuple[int, int, int] = (0, 0, 0), samples: int = 2) -> np.ndarray:
        """Unlit textured render as (height, width, 3) uint8 sRGB, antialiased by `samples` x `samples` rays per pixel."""
        return _blend_over(background, *self._average(camera, self._sample_color, samples))

    def render_masked_color(self, camera: Camera, samples: int = 2) -> tuple[np.ndarray, np.ndarray]:
        """Unlit textured render with a hard silhouette, like a photo cut out by its mask.

        Returns:
            image: (height, width, 3) uint8 sRGB, black where less than half of a pixel's rays hit the mesh.
            mask: (height, width) bool.
        """
        color, coverage = self._average(camera, self._sample_color, samples)
        mask = coverage >= 0.5
        return np.clip(np.rint(np.where(mask[..., None], color, 0.0)), 0, 255).astype(np.uint8), mask

    def render_cut_out(self, camera: Camera, samples: int = 2) -> tuple[np.ndarray, np.ndarray]:
        """Unlit textured render as (height, width, 3) uint8 sRGB, and (height, width) uint8 opacity."""
        color, coverage = self._average(camera, self._sample_color, samples)
        return np.clip(np.rint(color), 0, 255).astype(np.uint8), np.rint(coverage * 255).astype(np.uint8)

    def render_shaded(self, camera: Camera, background: tuple[int, int, int] = (255, 255, 255), samples: int = 2) -> np.ndarray:
        """Grey render lit from the camera, which shows the shape only, as (height, width, 3) uint8."""
        return _blend_over(background, *self._average(camera, self._shade, samples))

    def _average(self, camera: Camera, shade: Callable[[Camera, RayHits], np.ndarray], samples: int) -> tuple[np.ndarray, np.ndarray]:
        """(height, width, 3) mean colour of those rays of a pixel that hit the mesh, and (height, width) their share."""
        color = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
        coverage = np.zeros((camera.height_px, camera.width_px), np.float32)
        window, cropped = self._around_mesh(camera)
        if coverage[window].size:
            fine = cropped.resized(cropped.width_px * samples, cropped.height_px * samples)
            hits = self.cast_rays(fine)
            image = np.zeros((fine.height_px, fine.width_px, 3), np.float32)
            image[hits.mask] = shade(fine, hits)
            shape = (cropped.height_px, samples, cropped.width_px, samples)
            coverage[window] = hits.mask.reshape(shape).mean((1, 3), dtype=np.float32)
            color[window] = image.reshape(*shape, 3).mean((1, 3)) / np.maximum(coverage[window], 1e-6)[..., None]
        return color, coverage

    def _sample_color(self, camera: Camera, hits: RayHits) -> np.ndarray:
        if self.mesh.uv is None or self.mesh.texture is None:
            return np.full((int(hits.mask.sum()), 3), PLAIN_GREY)
        return sample_texture(self.mesh.texture, self._interpolate(self.mesh.uv, hits))

    def _shade(self, camera: Camera, hits: RayHits) -> np.ndarray:
        corners = self.mesh.vertices[self.mesh.faces[hits.face[hits.mask]]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        towards = camera.centre_in_world - corners.mean(1)
        cosine = np.einsum("ij,ij->i", normals, towards)
        cosine /= np.maximum(np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1), 1e-30)
        front = DARKEST + FACING_GAIN * np.clip(cosine, 0.0, 1.0)
        tint = np.where(cosine[:, None] < 0, BACK_TINT, 1.0)
        return np.where(cosine < 0, BACK_DARKEST - BACK_GAIN * cosine, front)[:, None] * tint

    def _interpolate(self, values: np.ndarray, hits: RayHits) -> np.ndarray:
        corners = values[self.mesh.faces[hits.face[hits.mask]]]
        second, third = hits.barycentric[hits.mask].T[:, :, None]
        return corners[:, 0] * (1.0 - second - third) + corners[:, 1] * second + corners[:, 2] * third


def _blend_over(background: tuple[int, int, int], color: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    image = color * coverage[..., None] + np.array(background, np.float32) * (1.0 - coverage[..., None])
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def sample_texture(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Look up (N, 2) texture coordinates, origin at the lower left, bilinearly; (N, C) float32. They wrap at the border."""
    height, width = texture.shape[:2]
    positions = np.stack([uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5], axis=1).astype(np.float32)
    sampled = sample_bilinear(texture, positions, cv2.BORDER_WRAP)
    return sampled if texture.ndim == 3 else sampled[:, None]
