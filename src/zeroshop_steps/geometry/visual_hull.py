"""The visual hull: what the masks alone say about the object's shape (Laurentini 1994)."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from zeroshop_steps.geometry.cameras import Camera


def find_inside_masks(points: np.ndarray, cameras: list[Camera], masks: list[np.ndarray], misses_allowed: int = 0) -> np.ndarray:
    """(P,) bool: which (P, 3) points project into the masks, (H, W) bool, of all cameras but `misses_allowed`.

    A point outside an image says nothing about that camera's mask unless the mask is a crop, as here: it counts as a miss.
    """
    misses = np.zeros(len(points), int)
    kept = np.arange(len(points))
    for camera, mask in zip(cameras, masks, strict=True):
        pixels, depths = camera.project(points[kept])
        x = np.floor(np.nan_to_num(pixels[:, 0], nan=-1.0)).clip(-1, camera.width_px).astype(int)
        y = np.floor(np.nan_to_num(pixels[:, 1], nan=-1.0)).clip(-1, camera.height_px).astype(int)
        framed = (depths > 0) & (x >= 0) & (x < camera.width_px) & (y >= 0) & (y < camera.height_px)
        hit = np.zeros(len(kept), bool)
        hit[framed] = mask[y[framed], x[framed]]
        misses[kept] += ~hit
        # Most of a volume is soon outside: later cameras need not look at it.
        kept = kept[misses[kept] <= misses_allowed]
    return misses <= misses_allowed


@dataclass(frozen=True)
class VisualHull:
    """The visual hull as voxels: `occupied` (R, R, R) bool within the cube [-half_extent, half_extent]^3."""

    occupied: np.ndarray
    half_extent: float

    @staticmethod
    def carve(cameras: list[Camera], masks: list[np.ndarray], half_extent: float, resolution: int, misses_allowed: int = 0) -> "VisualHull":
        """Keep the voxels, `resolution` along each edge, whose centres lie inside the masks."""
        grid = voxel_centres(half_extent, resolution)
        return VisualHull(find_inside_masks(grid, cameras, masks, misses_allowed).reshape((resolution,) * 3), half_extent)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """(P, 3) centres of the outermost voxels and (P, 3) their outward unit normals, from the smoothed occupancy's gradient."""
        padded = np.pad(self.occupied, 1)
        buried = self.occupied.copy()
        for direction in range(3):
            for step in (-1, 1):
                buried &= np.roll(padded, step, direction)[1:-1, 1:-1, 1:-1]
        index = np.argwhere(self.occupied & ~buried)
        smooth = gaussian_filter(padded.astype(np.float32), 1.5)
        gradient = [map_coordinates(component, index.T + 1, order=1) for component in np.gradient(smooth)]
        normals = -np.stack(gradient, 1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return _axis(self.half_extent, len(self.occupied))[index], normals


def voxel_centres(half_extent: float, resolution: int) -> np.ndarray:
    """(resolution^3, 3) centres of the voxels of the cube [-half_extent, half_extent]^3, the last coordinate fastest."""
    axis = _axis(half_extent, resolution)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def _axis(half_extent: float, resolution: int) -> np.ndarray:
    return (np.arange(resolution) + 0.5) / resolution * 2 * half_extent - half_extent
