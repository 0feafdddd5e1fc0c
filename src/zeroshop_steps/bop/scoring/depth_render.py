"""Depth of a model in a pose, ray-cast within the model's projected box only."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.rasterization import NEAREST
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster


@dataclass(frozen=True)
class DepthPatch:
    """Part of a depth image; the rest of the image is empty.

    Attributes:
        left, top: column and row of its first pixel.
        depth_mm: (h, w) float32 depth along the optical axis, 0 beside the model.
    """

    left: int
    top: int
    depth_mm: np.ndarray

    def within(self, box: tuple[int, int, int, int]) -> np.ndarray:
        """(bottom - top, right - left) float32 depth in a box (left, top, right, bottom) that contains the patch."""
        left, top, right, bottom = box
        out = np.zeros((bottom - top, right - left), np.float32)
        height, width = self.depth_mm.shape
        out[self.top - top : self.top - top + height, self.left - left : self.left - left + width] = self.depth_mm
        return out

    def image(self, width_px: int, height_px: int) -> np.ndarray:
        """(height, width) float32 depth of the whole image."""
        return self.within((0, 0, width_px, height_px))


class DepthRenderer:
    """Renders one model; its search tree is built once, so further poses are cheap."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = ray_caster((mesh.vertices, mesh.faces))
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        self._corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])

    def render(self, camera_from_model: np.ndarray, intrinsics: np.ndarray, width_px: int, height_px: int) -> DepthPatch:
        """The model's depth in a (4, 4) pose in mm, seen through BOP's (3, 3) K; one ray through the centre of each pixel."""
        left, top, right, bottom = self._box(camera_from_model, intrinsics, width_px, height_px)
        if right <= left or bottom <= top:
            return DepthPatch(0, 0, np.zeros((0, 0), np.float32))
        pixels = np.stack(np.broadcast_arrays(np.arange(left, right), np.arange(top, bottom)[:, None], 1.0), -1)
        rotation, translation = camera_from_model[:3, :3], camera_from_model[:3, 3]
        rays = np.empty((*pixels.shape[:2], 6), np.float32)
        rays[..., :3] = -rotation.T @ translation
        rays[..., 3:] = pixels @ (rotation.T @ np.linalg.inv(intrinsics)).T
        depth = self._scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
        return DepthPatch(left, top, np.where(np.isfinite(depth), depth, 0.0).astype(np.float32))

    def _box(self, camera_from_model: np.ndarray, intrinsics: np.ndarray, width_px: int, height_px: int) -> tuple[int, int, int, int]:
        """(left, top, right, bottom) of the image that the model's bounding box covers."""
        corners = transform_points(self._corners, camera_from_model)
        if (corners[:, 2] < NEAREST).all():
            return 0, 0, 0, 0
        if (corners[:, 2] < NEAREST).any():
            return 0, 0, width_px, height_px
        projected = corners @ intrinsics.T
        pixels = projected[:, :2] / projected[:, 2:]
        low, high = np.floor(pixels.min(0)), np.ceil(pixels.max(0)) + 1
        left, top = np.clip(low, 0, (width_px, height_px)).astype(int)
        right, bottom = np.clip(high, 0, (width_px, height_px)).astype(int)
        return int(left), int(top), int(right), int(bottom)
