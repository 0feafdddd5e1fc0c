"""Voxels above the support plane: what the views say of each, their silhouettes, and the things they form."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy import ndimage

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads

VOXEL_WIDTH = 0.7  # of a voxel's edge: odds are averaged over this width, so that the neighbours' are not
SPLAT_WIDTH = 1.2  # of a voxel's edge: a cube seen at an angle is wider than its edge, and no gaps may remain between cubes
MISSES_SHARE, MISSES = 0.1, 1.0
"""A voxel is occupied although so many views miss it, as a share of those that see it and at least as a number: single masks fail."""
FULL_SHARE, LEAST_VIEWS = 0.35, 3  # of the views that see a voxel must show it, and at least so many
SHARES = (0.25, 0.5, 0.75, 0.95)  # of the other views that show a voxel, as far as they are told apart


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
    """What V views say of P voxels.

    Attributes:
        inside: (V, P) bool: which views have which voxels in the photo.
        votes: (V, P) float32: 1 where a view shows the voxel, -1 where it shows something else, between these where it is doubtful.
    """

    inside: np.ndarray
    votes: np.ndarray

    @cached_property
    def seen(self) -> np.ndarray:
        """(P,) int: how many views have each in the photo."""
        return np.asarray(self.inside.sum(0))

    @cached_property
    def shown(self) -> np.ndarray:
        """(P,) float32: how many views show each."""
        return np.asarray(np.maximum(self.votes, 0).sum(0))

    @cached_property
    def missed(self) -> np.ndarray:
        """(P,) float32: how many views show something else there."""
        return np.asarray(-np.minimum(self.votes, 0).sum(0))

    def take(self, chosen: np.ndarray) -> "Votes":
        """Those on some of the voxels, (P,) bool."""
        return Votes(self.inside[:, chosen], self.votes[:, chosen])

    def shares_without(self, view: int) -> np.ndarray:
        """(P,) float32 of 0 to 1: share of the other views that show each, of those that have it in the photo; 0 where these are few."""
        others = self.seen - self.inside[view]
        shown = self.shown - np.maximum(self.votes[view], 0)
        return np.where(others >= LEAST_VIEWS - 1, shown / np.maximum(others, 1), 0).astype(np.float32)


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

    inside, votes = (np.stack(parts) for parts in zip(*map_in_threads(vote, cameras, odds), strict=True))
    return Votes(inside, votes)


def carve(grid: VoxelGrid, index: np.ndarray, votes: Votes) -> np.ndarray:
    """(X, Y, Z) bool: which of the voxels (P, 3) nearly all views show, a visual hull (Laurentini 1994) that bears a few wrong views."""
    kept = votes.missed <= np.maximum(MISSES_SHARE * votes.seen, np.where(votes.seen > 2 * LEAST_VIEWS, MISSES, 0.0))
    kept &= (votes.shown >= FULL_SHARE * votes.seen) & (votes.seen >= LEAST_VIEWS)
    occupied = np.zeros(grid.shape, bool)
    occupied[tuple(index[kept].T)] = True
    return occupied


def render_shares(grid: VoxelGrid, index: np.ndarray, votes: Votes, cameras: Sequence[Camera]) -> list[np.ndarray]:
    """For each view, (H, W) float32 of 0 to 1: the largest share of the other views that show a voxel (P, 3) on the pixel's ray.

    What is thin is missing in some masks, and so in their hull; and one wrong mask must not vote for itself. Shares are told apart at
    `SHARES` only.
    """
    centres = grid.centres(index)

    def render(view: int) -> np.ndarray:
        camera = cameras[view]
        shares, picture = votes.shares_without(view), np.zeros((camera.height_px, camera.width_px), np.float32)
        for share in SHARES:
            picture[splat_voxels(centres[shares >= share], grid.side, camera)] = share
        return picture

    return map_in_threads(render, range(len(cameras)))


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
