"""Free space by line of sight: what lies before a confirmed surface, as seen by the view that confirmed it, is empty."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, minimum_filter

from zeroshop_steps.cameras import Camera

FILL_PX = 12.0
"""Gaps of the confirmed depths are filled from the nearest one within this reach."""
CAUTION_PX = 9
FREE_MARGIN = 0.05


@dataclass(frozen=True)
class SeenThrough:
    """What confirmed depths say of a point: views that see through it, and views that see it.

    Attributes:
        cameras: the views. depths: (H, W) confirmed depth of each, gaps filled, 0 where unknown.
        nearest: (H, W) the least of these depths within a few pixels, so that a slanted surface does not vote against itself.
    """

    cameras: list[Camera]
    depths: list[np.ndarray]
    nearest: list[np.ndarray]

    @staticmethod
    def by(cameras: list[Camera], depth_maps: list[np.ndarray]) -> "SeenThrough":
        """From confirmed depth maps, 0 where nothing was confirmed."""
        depths = [_filled(depth, FILL_PX) for depth in depth_maps]
        nearest = [minimum_filter(np.where(depth > 0, depth, np.inf), CAUTION_PX) for depth in depths]
        return SeenThrough(cameras, depths, nearest)

    def free(self, points: np.ndarray) -> np.ndarray:
        """(P,) bool: points that two views or more see through, and more than see them as surface."""
        against, in_favour = np.zeros(len(points), int), np.zeros(len(points), int)
        for camera, depth, nearest in zip(self.cameras, self.depths, self.nearest, strict=True):
            pixels, z = camera.project(points)
            x, y = np.floor(pixels).astype(int).T
            framed = np.flatnonzero((x >= 0) & (x < camera.width_px) & (y >= 0) & (y < camera.height_px))
            known = framed[depth[y[framed], x[framed]] > 0]
            against[known] += nearest[y[known], x[known]] > z[known] + FREE_MARGIN
            in_favour[known] += np.abs(depth[y[known], x[known]] - z[known]) <= FREE_MARGIN
        return (against >= 2) & (against > in_favour)


def _filled(depth: np.ndarray, reach_px: float) -> np.ndarray:
    if not depth.any():
        return depth
    distance, (y, x) = distance_transform_edt(depth == 0, return_indices=True)
    return np.where(distance <= reach_px, depth[y, x], 0.0)
