"""Voxels above the support plane: what the views say of each, their silhouettes, and the things they form."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.runtime.thread_pool import map_in_threads

VOXEL_WIDTH = 0.7  # of a voxel's edge: odds are averaged over this width, so that the neighbours' are not
SPLAT_WIDTH = 1.2  # of a voxel's edge: a cube seen at an angle is wider than its edge, and no gaps may remain between cubes
MISSES_SHARE, MISSES = 0.1, 1.0
"""A voxel is occupied although so many views miss it, as a share of those that see it and at least as a number: single masks fail."""
FULL_SHARE, LEAST_VIEWS = 0.35, 3  # of the views that see a voxel must show it, and at least so many


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

    def look_up(self, occupied: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(P,) bool: which world positions (P, 3) lie in occupied voxels, (X, Y, Z) bool."""
        index, inside = self.locate(points)
        inside[inside] = occupied[tuple(index[inside].T)]
        return inside


@dataclass(frozen=True)
class Votes:
    """What views say of P voxels.

    Attributes:
        seen: (P,) int, how many views have each in the photo.
        shown, missed: (P,) float32, how many of these show it and how many show something else, doubtful ones in part.
    """

    seen: np.ndarray
    shown: np.ndarray
    missed: np.ndarray


def count_votes(grid: VoxelGrid, index: np.ndarray, cameras: Sequence[Camera], odds: Sequence[np.ndarray], most: float = 1.0) -> Votes:
    """Let the views vote on the voxels (P, 3) of a block.

    Args:
        grid, index: the block and the voxels.
        cameras: of all views.
        odds: (H, W) float32 log odds of the object in each, of the cameras' sizes; 0 where nothing is known.
        most: log odds that count as one full vote.
    """
    centres = grid.centres(index).astype(np.float32)

    def vote(camera: Camera, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, columns, depth, inside = camera.find_pixels(centres)
        votes = np.zeros(len(index), np.float32)
        if inside.any():
            width = max(1, round(VOXEL_WIDTH * grid.side * camera.intrinsics[0, 0] / float(np.median(depth[inside]))))
            mean = cv2.blur(known, (width, width), borderType=cv2.BORDER_REPLICATE)
            votes[inside] = np.clip(mean[rows[inside], columns[inside]] / most, -1, 1)
        return inside, votes

    seen, shown, missed = np.zeros(len(index), np.int32), np.zeros(len(index), np.float32), np.zeros(len(index), np.float32)
    for inside, votes in map_in_threads(vote, cameras, odds):
        seen += inside
        shown += np.maximum(votes, 0)
        missed -= np.minimum(votes, 0)
    return Votes(seen, shown, missed)


def carve(grid: VoxelGrid, index: np.ndarray, cameras: Sequence[Camera], odds: Sequence[np.ndarray], most: float = 1.0) -> np.ndarray:
    """(X, Y, Z) bool: which of the voxels (P, 3) nearly all views show, a visual hull (Laurentini 1994) that bears a few wrong views.

    Arguments as of `count_votes`.
    """
    votes = count_votes(grid, index, cameras, odds, most)
    kept = votes.missed <= np.maximum(MISSES_SHARE * votes.seen, np.where(votes.seen > 2 * LEAST_VIEWS, MISSES, 0.0))
    kept &= (votes.shown >= FULL_SHARE * votes.seen) & (votes.seen >= LEAST_VIEWS)
    occupied = np.zeros(grid.shape, bool)
    occupied[tuple(index[kept].T)] = True
    return occupied


def splat_voxels(points: np.ndarray, side: float, camera: Camera) -> np.ndarray:
    """(H, W) bool: where cubes of edge `side` around (P, 3) points fall in a view: as wide as the median one, and nearer ones wider."""
    picture = np.zeros((camera.height_px, camera.width_px), bool)
    rows, columns, depth, inside = camera.find_pixels(points)
    if not inside.any():
        return picture
    rows, columns = rows[inside], columns[inside]
    edge_px = side * camera.intrinsics[0, 0]  # at a depth of 1
    least_px = SPLAT_WIDTH * edge_px / float(np.median(depth[depth > 0]))
    # Among the cubes, a camera has some right before it, which hide all.
    most_px = 2 * max(camera.width_px, camera.height_px)
    widths_px = np.ceil(np.clip(edge_px / depth[inside], least_px, most_px)).astype(int) | 1
    for width_px in np.unique(widths_px).tolist():
        alike = widths_px == width_px
        picture |= _mark_squares(camera, rows[alike], columns[alike], width_px)
    return picture


def _mark_squares(camera: Camera, rows: np.ndarray, columns: np.ndarray, width_px: int) -> np.ndarray:
    picture = np.zeros((camera.height_px, camera.width_px), np.uint8)
    picture[rows, columns] = 1
    return np.asarray(cv2.dilate(picture, np.ones((width_px, width_px), np.uint8)) > 0)


def render_silhouettes(grid: VoxelGrid, occupied: np.ndarray, cameras: Sequence[Camera]) -> list[np.ndarray]:
    """For each view, (H, W) bool: where it sees occupied voxels, (X, Y, Z) bool, drawn as `splat_voxels` does."""
    shell = occupied & ~ndimage.binary_erosion(occupied, border_value=0)
    centres = grid.centres(np.argwhere(shell))
    return map_in_threads(lambda camera: splat_voxels(centres, grid.side, camera), cameras)
