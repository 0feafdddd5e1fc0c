"""The visual hull: the largest shape whose silhouettes lie in all masks (Laurentini 1994)."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from zeroshop_steps.geometry.cameras.pinhole import Camera

COARSE_VOXELS = 96  # along each edge of a hull that tells where the object is, and no detail of it
SMOOTHING_VOXELS = 1.5  # standard deviation that takes the steps of voxels away: normals and distances need a smooth occupancy


def find_inside_masks(points: np.ndarray, cameras: list[Camera], masks: list[np.ndarray], misses_allowed: int = 0) -> np.ndarray:
    """(P,) bool: which (P, 3) points project into the masks, (H, W) bool, of all cameras but `misses_allowed`.

    A point off an image counts as a miss, because the images are crops around the masks, unless the mask touches the image's border on
    that side: there the object is cut off, and what lies beyond is not known.
    """
    misses = np.zeros(len(points), int)
    kept = np.arange(len(points))
    for camera, mask in zip(cameras, masks, strict=True):
        rows, columns, depth, framed = camera.find_pixels(points[kept])
        hit = (depth > 0) & ~framed & _is_beyond_cut(rows, columns, mask)
        hit[framed] = mask[rows[framed], columns[framed]]
        misses[kept] += ~hit
        # Most of a volume is outside of the first masks already, and is not tested with the others.
        kept = kept[misses[kept] <= misses_allowed]
    return misses <= misses_allowed


def measure_hull_depth(points: np.ndarray, cameras: Sequence[Camera], masks: Sequence[np.ndarray]) -> np.ndarray:
    """(P,) how far (P, 3) points lie below the surface of the visual hull of masks, (H, W) bool; 0 outside of it.

    A ball around a point lies in the hull if its silhouettes lie in all masks, so the depth is the smallest distance to an outline,
    taken at the point's depth. What lies off an image is not known; a point that no image shows is infinitely deep.
    """
    depths = np.full(len(points), np.inf)
    for camera, mask in zip(cameras, masks, strict=True):
        if mask.all():
            continue
        inwards_px = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
        rows, columns, depth, framed = camera.find_pixels(points)
        length = inwards_px[rows[framed], columns[framed]] * depth[framed] / camera.intrinsics[0, 0]
        depths[framed] = np.minimum(depths[framed], length)
    return depths


def _is_beyond_cut(rows: np.ndarray, columns: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(P,) bool: pixels that lie off an image only on sides that its mask touches."""
    height, width = mask.shape
    off = np.array([rows < 0, rows >= height, columns < 0, columns >= width])
    touched = np.array([mask[0].any(), mask[-1].any(), mask[:, 0].any(), mask[:, -1].any()])
    return (touched[:, None] | ~off).all(0)


@dataclass(frozen=True)
class VisualHull:
    """The visual hull as voxels: `occupied` (R, R, R) bool in the cube [-half_extent, half_extent]^3."""

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
        smooth = gaussian_filter(padded.astype(np.float32), SMOOTHING_VOXELS)
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
