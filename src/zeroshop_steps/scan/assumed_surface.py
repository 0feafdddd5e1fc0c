"""Without depth, nothing is known of the surface but the box around it: its four sides and its top are what views are counted for.

That spreads views evenly and from all sides; it cannot know of hollows, and of what hides what.
"""

from collections.abc import Sequence

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.meshes.triangle_meshes import FACING_COSINE
from zeroshop_steps.scan.cell_visibility import FREE, see_cells
from zeroshop_steps.scan.surface_map import Coverage
from zeroshop_steps.scan.workspace import Box

CELLS = 12  # along each side of a face
BESIDE_M = np.array([1e3, 1e3, -1e3])  # where the grid of what hides the box lies: nowhere near


class AssumedSurface:
    """A map without depth; for `least_views` see `MeasuredSurface`."""

    def __init__(self, box: Box, least_views: int = 3) -> None:
        self.box, self.least_views = box, least_views
        steps = (np.arange(CELLS) + 0.5) / CELLS
        across = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
        points, normals = [], []
        for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1), (2, 1)):
            face = np.insert(across, axis, float(side), axis=1)
            points.append(box.low_m + face * (box.high_m - box.low_m))
            normals.append(np.tile((2.0 * side - 1.0) * np.eye(3)[axis], (len(face), 1)))
        self._points, self._normals = np.concatenate(points), np.concatenate(normals)
        self._views = np.zeros(len(self._points), int)

    def add_view(self, camera: Camera, depth_m: np.ndarray | None) -> None:
        """Count a view; depth is not looked at."""
        self._views += self._see([camera])[0]

    def gains(self, cameras: Sequence[Camera]) -> np.ndarray:
        """(C,) cells that each camera sees, each by the share of the wanted views that it lacks."""
        return np.asarray(self._see(cameras) @ (np.maximum(self.least_views - self._views, 0) / self.least_views), float)

    def coverage(self) -> Coverage:
        """Of the box's sides and top."""
        return Coverage(len(self._points), float((self._views >= self.least_views).mean()), 0)

    def extent(self) -> Box:
        """The box."""
        return self.box

    def _see(self, cameras: Sequence[Camera]) -> np.ndarray:
        # The box is convex, so that nothing hides what faces the camera.
        nothing = np.full((1, 1, 1), FREE, np.uint8)
        return see_cells(nothing, BESIDE_M, 1.0, self._points, self._normals, FACING_COSINE, cameras)
