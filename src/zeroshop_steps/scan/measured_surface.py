"""The surface that depth images have measured so far, and where more may be: a grid of cells that are unknown, free or surface.

A view makes the cells before what it measured free, and those about it surface, as occupancy grids and truncated distances do (Elfes 1989;
Curless and Levoy 1996). Unknown cells beside free ones are the frontier (Yamauchi 1997): a view gains the part of it that it sees, as in
Connolly's planner (1985) and the "unobserved voxels" of Isler et al. (2016).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.transforms import make_unit
from zeroshop_steps.geometry.meshes.triangle_meshes import FACING_COSINE
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE
from zeroshop_steps.geometry.observation.visual_hull import SMOOTHING_VOXELS
from zeroshop_steps.scan.cell_visibility import FREE, see_cells
from zeroshop_steps.scan.surface_map import Coverage
from zeroshop_steps.scan.workspace import Box, Grid

UNKNOWN, SURFACE = 0, 2  # states of cells, beside FREE
LEAST_BAND_M = 0.002  # before a measured point, cells count as surface up to this, or up to a cell: sensors are no more exact
BEHIND_BANDS = 0.7  # and behind it: less, so that walls of two cells have two sides
TRIES = 2  # a frontier that so many views looked at without measuring it counts no longer: it is dark, shiny, or too steep
LEAST_SURFACE = 30  # cells, from which on the extent is that of the surface


class MeasuredSurface:
    """A map from depth images.

    Args:
        box: that holds the object and stands on the table; nothing else must be in it.
        least_views: how many views of each part of the surface are wanted, within 60 degrees of its normal: 1 for depth alone, 3 for
            photos, since fewer leave stereo without a check.
        cells: along the box's longest side.
        second_eye_m: (3,) where the sensor's projector, or its second camera, is, along the camera's axes: depth is measured where both
            see; None where that is not known.
    """

    def __init__(self, box: Box, least_views: int = 1, cells: int = 64, second_eye_m: np.ndarray | None = None) -> None:
        # Measured depth of the table deviates; what is lower than this cannot be told from it.
        cell_m = float((box.high_m - box.low_m).max()) / cells
        self.band_m = max(cell_m, LEAST_BAND_M)
        self.box, self.least_views, self._second_eye_m = box, least_views, second_eye_m
        self.grid = Grid.fill(Box(box.low_m + [0.0, 0.0, self.band_m], box.high_m), cells)
        self._middles = self.grid.middles()
        self._free = np.zeros(len(self._middles), np.uint16)
        self._surface = np.zeros(len(self._middles), np.uint16)
        self._tries = np.zeros(len(self._middles), np.uint8)
        self._cameras: list[Camera] = []

    @cached_property
    def states(self) -> np.ndarray:
        """(X, Y, Z) uint8: UNKNOWN, FREE or SURFACE; what as many views found to be surface as free is surface."""
        states = np.where(self._surface >= np.maximum(self._free, 1), SURFACE, np.where(self._free > 0, FREE, UNKNOWN))
        return states.astype(np.uint8).reshape(self.grid.shape)

    def add_view(self, camera: Camera, depth_m: np.ndarray | None) -> None:
        """Take a view with its (height, width) depth in metres. Without depth, it counts as a view of what others measured alone."""
        frontier, normals, _, _ = self._cells
        looked_at = self._measure(frontier, normals, [camera])[0]
        if depth_m is not None:
            rows, columns, depth, inside = camera.find_pixels(self._middles)
            cells = np.flatnonzero(inside)
            ahead_m = depth_m[rows[cells], columns[cells]] - depth[cells]
            measured = depth_m[rows[cells], columns[cells]] > 0
            self._free[cells[measured & (ahead_m > self.band_m)]] += 1
            is_surface = (ahead_m <= self.band_m) & (ahead_m >= -BEHIND_BANDS * self.band_m)
            self._surface[cells[measured & is_surface]] += 1
        self._tries[frontier[looked_at]] += 1
        self._cameras.append(camera)
        for derived in ("states", "_cells", "_views"):
            self.__dict__.pop(derived, None)

    def gains(self, cameras: Sequence[Camera]) -> np.ndarray:
        """(C,) cells of the frontier that each camera sees, those that were tried halved, and cells of surface that lack views.

        A cell of surface counts by the share of the wanted views that it lacks.
        """
        frontier, normals, surface, surface_normals = self._cells
        weights = 0.5 ** self._tries[frontier].astype(float)
        gains = self._measure(frontier, normals, cameras) @ weights
        lacks = np.maximum(self.least_views - self._views, 0) / self.least_views
        lacking = lacks > 0
        if lacking.any():
            gains += self._see(surface[lacking], surface_normals[lacking], FACING_COSINE, cameras) @ lacks[lacking]
        return np.asarray(gains, float)

    def coverage(self) -> Coverage:
        """Cells of surface beside free ones, and of the frontier."""
        frontier, _, surface, _ = self._cells
        seen = float((self._views >= self.least_views).mean()) if len(surface) else 0.0
        return Coverage(len(surface), seen, len(frontier))

    def extent(self) -> Box:
        """The box around the surface; the whole box while little is measured."""
        _, _, surface, _ = self._cells
        if len(surface) < LEAST_SURFACE:
            return self.box
        points, margin = self.grid.middles_of(surface), self.grid.cell_m
        low = np.append(points[:, :2].min(0) - margin, self.box.low_m[2])
        return Box(low, points.max(0) + margin)

    @cached_property
    def _cells(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(F,) cells of the frontier and (F, 3) their normals, towards free space; (S,) cells of surface beside free ones, and theirs."""
        # Beside and above the box all is free, below it is the table.
        free = np.pad(self.states == FREE, 1, constant_values=True)
        free[:, :, 0] = False
        beside = np.zeros(self.states.shape, bool)
        for axis in range(3):
            for step in (-1, 1):
                beside |= np.roll(free, step, axis)[1:-1, 1:-1, 1:-1]
        blurred = ndimage.gaussian_filter(free.astype(np.float32), SMOOTHING_VOXELS)
        slopes = np.stack([slope[1:-1, 1:-1, 1:-1].ravel() for slope in np.gradient(blurred)], -1)
        open_cells = (self.states == UNKNOWN) & beside & (self._tries < TRIES).reshape(self.states.shape)
        frontier, surface = np.flatnonzero(open_cells), np.flatnonzero((self.states == SURFACE) & beside)
        return frontier, make_unit(slopes[frontier]), surface, make_unit(slopes[surface])

    @cached_property
    def _views(self) -> np.ndarray:
        """(S,) views that saw each cell of surface within 60 degrees of its normal."""
        _, _, surface, normals = self._cells
        return np.asarray(self._see(surface, normals, FACING_COSINE, self._cameras).sum(0))

    def _measure(self, cells: np.ndarray, normals: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
        """(C, N) bool: the cells that both eyes of the sensor see."""
        seen = self._see(cells, normals, GRAZING_COSINE, cameras)
        if self._second_eye_m is not None:
            seen &= self._see(cells, normals, GRAZING_COSINE, [_shift(camera, self._second_eye_m) for camera in cameras])
        return seen

    def _see(self, cells: np.ndarray, normals: np.ndarray, least_cosine: float, cameras: Sequence[Camera]) -> np.ndarray:
        targets = self.grid.middles_of(cells)
        return see_cells(self.states, self.grid.low_m, self.grid.cell_m, targets, normals, least_cosine, cameras)


def _shift(camera: Camera, eye_m: np.ndarray) -> Camera:
    """The second eye of a camera, which sees beyond the border of its image."""
    pose = camera.camera_from_world.copy()
    pose[:3, 3] -= eye_m
    width, height = camera.width_px, camera.height_px
    return replace(camera, camera_from_world=pose).cropped(-width, -height, 3 * width, 3 * height)
