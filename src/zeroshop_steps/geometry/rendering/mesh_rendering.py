"""Render a mesh: depth, mask, surface coordinates and unlit colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import make_unit
from zeroshop_steps.geometry.imaging.images import sample_bilinear
from zeroshop_steps.geometry.meshes.surface_parts import PLAIN_GREY
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.rasterization_kernel import draw_faces, find_shares
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

if TYPE_CHECKING:
    from zeroshop_steps.geometry.rendering.cuda_rasterization import CudaFaces

NEAREST_SHARE = 0.01
"""A mesh is rasterized if its nearest vertex is farther from the camera's plane than so much of its farthest one."""
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


@dataclass(frozen=True)
class _Sight:
    """The mesh before a camera: the camera of the pixels that may see it, columns and rows of the vertices there, and their depths."""

    camera: Camera
    columns_rows: np.ndarray
    depths: np.ndarray
    is_before_camera: bool


class MeshRenderer:
    """Draws one mesh as many cameras see it.

    Its faces are rasterized. Where a camera is inside the mesh or right before it, rays are cast.
    """

    def __init__(self, mesh: Mesh, device: str = "cpu") -> None:
        """Draw `mesh`, and rasterize it on `device`, cpu or cuda."""
        self.mesh, self._faces = mesh, np.ascontiguousarray(mesh.faces, np.int32)
        self._on_device: CudaFaces | None = None
        if device == "cuda":
            from zeroshop_steps.geometry.rendering.cuda_rasterization import CudaFaces

            self._on_device = CudaFaces(self._faces)

    @cached_property
    def scene(self) -> o3d.t.geometry.RaycastingScene:
        """For rays and nearest points."""
        return ray_caster((self.mesh.vertices, self.mesh.faces))

    def find_depth(self, camera: Camera) -> np.ndarray:
        """(height, width) float32 depth as `cast_rays` finds it, without the rest."""
        depth = np.zeros((camera.height_px, camera.width_px), np.float32)
        window, seen = self._look(camera)
        depth[window] = self._rasterize(seen)[0] if seen.is_before_camera else self._cast(seen.camera).depth
        return depth

    def cast_rays(self, camera: Camera) -> RayHits:
        """What the rays through the pixel centres of `camera` hit first."""
        shape = (camera.height_px, camera.width_px)
        hits = RayHits(np.full(shape, -1, np.int64), np.zeros((*shape, 2), np.float32), np.zeros(shape, np.float32))
        window, seen = self._look(camera)
        found = self._rasterize_with_shares(seen) if seen.is_before_camera else self._cast(seen.camera)
        hits.face[window], hits.barycentric[window], hits.depth[window] = found.face, found.barycentric, found.depth
        return hits

    def find_window(self, camera: Camera) -> tuple[tuple[slice, slice], Camera]:
        """Rows and columns of the pixels that may see the mesh, and the camera of these pixels alone."""
        window, seen = self._look(camera)
        return window, seen.camera

    def _look(self, camera: Camera) -> tuple[tuple[slice, slice], _Sight]:
        pixels, depths = camera.project(self.mesh.vertices)
        size = np.array([camera.width_px, camera.height_px])
        first, last = np.zeros(2, int), size
        is_before_camera = len(depths) > 0 and depths.min() > NEAREST_SHARE * depths.max()
        if is_before_camera:
            # Two pixels at least, also where the mesh is beside the image: no filter or lookup takes an image without any.
            low, high = ([extreme(pixels[:, axis]) for axis in (0, 1)] for extreme in (np.min, np.max))  # .min(0) takes 50 times as long
            first = np.clip(np.floor(low) - 1, 0, np.maximum(size - 2, 0)).astype(int)
            last = np.clip(np.ceil(high) + 1, first + 2, size).astype(int)
        (left, top), (width_px, height_px) = first.tolist(), (last - first).tolist()
        window = (slice(top, top + height_px), slice(left, left + width_px))
        # Pixel (0, 0)'s centre is at the origin of the rasterizer.
        columns_rows = (pixels - (first + 0.5)).astype(np.float32)
        return window, _Sight(camera.cropped(left, top, width_px, height_px), columns_rows, depths.astype(np.float32), is_before_camera)

    def _rasterize(self, seen: _Sight) -> tuple[np.ndarray, np.ndarray]:
        """(height, width) depth, 0 where nothing is, and face."""
        shape = (seen.camera.height_px, seen.camera.width_px)
        if self._on_device:
            inverse_depth, face = self._on_device.draw(seen.columns_rows, seen.depths, 0.0, shape)
        else:
            (inverse_depth,), (face,) = draw_faces(seen.columns_rows[None], seen.depths[None], self._faces, 0.0, (1, *shape))
        depth = np.zeros(shape, np.float32)
        np.divide(np.float32(1), inverse_depth, out=depth, where=inverse_depth > 0)
        return depth, face

    def _rasterize_with_shares(self, seen: _Sight) -> RayHits:
        depth, face = self._rasterize(seen)
        shares = np.empty((1, *face.shape, 3), np.float32)
        find_shares(seen.columns_rows[None], seen.depths[None], self._faces, face[None], shares)
        return RayHits(face, shares[0, ..., 1:], depth)

    def _cast(self, camera: Camera) -> RayHits:
        k, pose = o3d.core.Tensor(camera.intrinsics), o3d.core.Tensor(camera.camera_from_world)
        # These rays have unit depth along the optical axis, so t_hit is the depth.
        found = self.scene.cast_rays(o3d.t.geometry.RaycastingScene.create_rays_pinhole(k, pose, camera.width_px, camera.height_px))
        distance = found["t_hit"].numpy()
        hit = np.isfinite(distance)
        face = np.where(hit, found["primitive_ids"].numpy().astype(np.int64), -1)
        return RayHits(face, found["primitive_uvs"].numpy(), np.where(hit, distance, np.float32(0)))

    def render_color(self, camera: Camera, background: tuple[int, int, int] = (255, 255, 255), samples: int = 2) -> np.ndarray:
        """Unlit coloured render as (height, width, 3) uint8 sRGB, antialiased by `samples` x `samples` rays per pixel."""
        return _blend_over(background, *self._average(camera, self._sample_color, samples))

    def render_masked_color(self, camera: Camera, samples: int = 2) -> tuple[np.ndarray, np.ndarray]:
        """Unlit coloured render with a hard silhouette, like a photo cut out by its mask.

        Returns:
            image: (height, width, 3) uint8 sRGB, black where less than half of a pixel's rays hit the mesh.
            mask: (height, width) bool.
        """
        color, coverage = self._average(camera, self._sample_color, samples)
        mask = coverage >= 0.5
        return np.clip(np.rint(np.where(mask[..., None], color, 0.0)), 0, 255).astype(np.uint8), mask

    def render_cut_out(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Unlit coloured render as (height, width, 3) uint8 sRGB, and (height, width) uint8 opacity."""
        color, coverage = self._average(camera, self._sample_color, 2)
        return np.clip(np.rint(color), 0, 255).astype(np.uint8), np.rint(coverage * 255).astype(np.uint8)

    def render_shaded(self, camera: Camera) -> np.ndarray:
        """Grey render lit from the camera, which shows the shape only, on white, as (height, width, 3) uint8."""
        return _blend_over((255, 255, 255), *self._average(camera, self._shade, 2))

    def _average(self, camera: Camera, shade: Callable[[Camera, RayHits], np.ndarray], samples: int) -> tuple[np.ndarray, np.ndarray]:
        """(height, width, 3) mean colour of those rays of a pixel that hit the mesh, and (height, width) their share."""
        color = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
        coverage = np.zeros((camera.height_px, camera.width_px), np.float32)
        window, cropped = self.find_window(camera)
        fine = cropped.resized(cropped.width_px * samples, cropped.height_px * samples)
        hits = self.cast_rays(fine)
        image = np.zeros((fine.height_px, fine.width_px, 3), np.float32)
        image[hits.mask] = shade(fine, hits)
        shape = (cropped.height_px, samples, cropped.width_px, samples)
        coverage[window] = hits.mask.reshape(shape).mean((1, 3), dtype=np.float32)
        color[window] = image.reshape(*shape, 3).mean((1, 3)) / np.maximum(coverage[window], 1e-6)[..., None]
        return color, coverage

    def _sample_color(self, camera: Camera, hits: RayHits) -> np.ndarray:
        if self.mesh.uv is not None and self.mesh.texture is not None:
            return sample_texture(self.mesh.texture, self._interpolate(self.mesh.uv, hits))
        if self.mesh.colors is not None:
            return self._interpolate(self.mesh.colors.astype(np.float32), hits)
        return np.full((int(hits.mask.sum()), 3), float(PLAIN_GREY))

    def _shade(self, camera: Camera, hits: RayHits) -> np.ndarray:
        face = hits.face[hits.mask]
        towards = make_unit(camera.centre_in_world - self.mesh.vertices[self.mesh.faces[face]].mean(1))
        cosine = np.einsum("ij,ij->i", self.mesh.face_normals()[face], towards)
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
