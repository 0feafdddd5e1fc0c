"""Voxels above the support plane: which of them the views show to be empty, and which clusters remain."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.runtime.thread_pool import map_in_threads

VOXEL_WIDTH = 0.7  # of a voxel's edge: evidence is averaged over this width, so that the neighbours' is not
SPLAT_WIDTH = 1.2  # of a voxel's edge: a cube seen at an angle is wider than its edge, and no gaps may remain between cubes


@dataclass(frozen=True)
class VoxelGrid:
    """A block of cubic voxels.

    Attributes:
        axes: (3, 3) unit rows: two along the support plane, then its normal.
        origin: (3,) the corner of the first voxel, in the world frame.
        side: edge of a voxel.
        shape: number of voxels along each axis.
    """

    axes: np.ndarray
    origin: np.ndarray
    side: float
    shape: tuple[int, int, int]

    def centres(self, index: np.ndarray) -> np.ndarray:
        """(P, 3) world positions of the middles of the voxels (P, 3)."""
        return self.origin + (index + 0.5) * self.side @ self.axes if len(index) else np.zeros((0, 3))

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The voxels (P, 3) of world positions (P, 3), and (P,) bool: which of them lie in the block."""
        index = np.floor((points - self.origin) @ self.axes.T / self.side).astype(int).reshape(-1, 3)
        return index, ((index >= 0) & (index < self.shape)).all(axis=1)


def count_votes(
    grid: VoxelGrid, index: np.ndarray, cameras: list[Camera], evidence: list[np.ndarray], sure: float
) -> tuple[np.ndarray, np.ndarray]:
    """How many views show each voxel full and how many show it empty, each (P,) int.

    Args:
        index: (P, 3) voxels.
        evidence: (H, W) log odds of every view, 0 where nothing is known.
        sure: a view votes where its mean log odds over about the voxel's width are larger than this.
    """
    centres = grid.centres(index).astype(np.float32)

    def vote(camera: Camera, odds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, columns, depth, inside = camera.find_pixels(centres)
        width = max(1, round(VOXEL_WIDTH * grid.side * camera.intrinsics[0, 0] / float(np.median(depth))))
        mean = cv2.blur(odds, (width, width), borderType=cv2.BORDER_REPLICATE)
        seen = np.zeros(len(index), odds.dtype)
        seen[inside] = mean[rows[inside], columns[inside]]
        return seen > sure, seen < -sure

    full, empty = np.zeros(len(index), np.int32), np.zeros(len(index), np.int32)
    for shown_full, shown_empty in map_in_threads(vote, cameras, evidence):
        full += shown_full
        empty += shown_empty
    return full, empty


def splat_voxels(points: np.ndarray, side: float, camera: Camera, one_width: bool = False) -> np.ndarray:
    """(H, W) bool: where cubes of edge `side` around (P, 3) points fall in a view.

    All are drawn as wide as the median one, and nearer ones wider. With `one_width` they are not: then the cubes of something tall that is
    seen from near have gaps between them.
    """
    picture = np.zeros((camera.height_px, camera.width_px), bool)
    rows, columns, depth, inside = camera.find_pixels(points)
    if not inside.any():
        return picture
    rows, columns = rows[inside], columns[inside]
    edge_px = side * camera.intrinsics[0, 0]  # at a depth of 1
    least_px = SPLAT_WIDTH * edge_px / float(np.median(depth[depth > 0]))
    # Among the cubes, a camera has some right before it, which hide all.
    most_px = least_px if one_width else 2 * max(camera.width_px, camera.height_px)
    widths_px = np.ceil(np.clip(edge_px / depth[inside], least_px, most_px)).astype(int) | 1
    for width_px in np.unique(widths_px).tolist():
        alike = widths_px == width_px
        picture |= _mark_squares(camera, rows[alike], columns[alike], width_px)
    return picture


def mark_points(points: np.ndarray, width_px: int, camera: Camera) -> np.ndarray:
    """(H, W) bool: squares `width_px` wide, an odd number, around the pixels that (P, 3) points fall into."""
    rows, columns, _, inside = camera.find_pixels(points)
    return _mark_squares(camera, rows[inside], columns[inside], width_px)


def _mark_squares(camera: Camera, rows: np.ndarray, columns: np.ndarray, width_px: int) -> np.ndarray:
    picture = np.zeros((camera.height_px, camera.width_px), np.uint8)
    picture[rows, columns] = 1
    return cv2.dilate(picture, np.ones((width_px, width_px), np.uint8)) > 0


def render_silhouettes(grid: VoxelGrid, occupied: np.ndarray, cameras: list[Camera], one_width: bool = False) -> list[np.ndarray]:
    """For each view, (H, W) bool: where it sees occupied voxels, (X, Y, Z) bool, drawn as `splat_voxels` does."""
    shell = occupied & ~ndimage.binary_erosion(occupied, border_value=0)
    centres = grid.centres(np.argwhere(shell))
    return [splat_voxels(centres, grid.side, camera, one_width) for camera in cameras]


def label_clusters(occupied: np.ndarray) -> tuple[np.ndarray, int]:
    """Label objects that stand side by side: (X, Y, Z) labels from 1 on, and their number.

    Voxels above each other belong to one object; a bridge one column wide does not join two objects.
    """
    columns = occupied.any(axis=2)
    cores = ndimage.binary_opening(columns, np.ones((2, 2)))
    labels, count = ndimage.label(cores, np.ones((3, 3)))
    if not count:
        return np.zeros(occupied.shape, np.int32), 0
    distance, nearest = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    footprint = np.where(distance <= 2.0, labels[tuple(nearest)], 0)
    return np.where(occupied, footprint[:, :, None], 0).astype(np.int32), count


def fill_down_to_ground(occupied: np.ndarray) -> np.ndarray:
    """The voxels and all voxels below them: ground that no view sees if the object stands there."""
    return np.flip(np.maximum.accumulate(np.flip(occupied, 2), axis=2), 2)
