"""The picture of the bare ground: what nearly all views show at each place of the support plane, whatever stands on it.

Most views see each place of the plane, even with objects on it. So the median over the views shows the plane alone, with its shadows:
background subtraction, with homographies of the plane in place of a fixed camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numba
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import space_evenly
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads

# Lengths are shares of the cameras' distance from the focus.
REACH = 0.9  # half the side of the square of the plane that the picture covers
CELL = 0.004  # side of one of its cells: about a pixel at 480 px of image width
MIN_WITNESSES = 3  # views that must see a cell; with two, an object in one of them is not outvoted
MOST_VIEWS = 24  # that are asked, evenly spread: the median of more is no better


@dataclass(frozen=True)
class GroundPicture:
    """The picture of the plane.

    Attributes:
        color: (N, N, 3) float32 RGB, 0 to 255: median over the views.
        spread: (N, N) float32: median deviation of the views from it.
        known: (N, N) bool: enough views see the cell.
        world_from_cell: (4, 3): homogeneous cell position (x, y, 1) to a homogeneous point of the plane.
        samples: (V, N, N, 3) float32: what each of the views that were asked sees, NaN where it sees nothing.
    """

    color: np.ndarray
    spread: np.ndarray
    known: np.ndarray
    world_from_cell: np.ndarray
    samples: np.ndarray

    def view_from_cell(self, camera: Camera) -> np.ndarray:
        """(3, 3) homography from cells to the pixels of a view, pixel centres at whole numbers."""
        return find_homography(camera, self.world_from_cell)


def lay_cells(support: SceneSupport, reach: float = REACH) -> tuple[int, np.ndarray]:
    """The number N of cells along each side of the picture, and (4, 3) `world_from_cell`; `reach` is half its side."""
    count = round(2 * reach / CELL)
    axes, cell = support.axes(), CELL * support.distance
    origin = support.foot - reach * support.distance * axes.sum(0) + cell / 2 * axes.sum(0)
    world_from_cell = np.zeros((4, 3))
    world_from_cell[:3] = np.stack([cell * axes[0], cell * axes[1], origin], axis=1)
    world_from_cell[3, 2] = 1.0
    return count, world_from_cell


def build_ground_picture(
    support: SceneSupport,
    cameras: Sequence[Camera],
    images: Sequence[np.ndarray],
    hidden: Sequence[np.ndarray] | None = None,
    reach: float = REACH,
) -> GroundPicture:
    """The median picture of the plane.

    Args:
        support: the plane.
        cameras: of all views.
        images: (H, W, 3) float32 RGB, 0 to 255, of their sizes.
        hidden: (H, W) bool: pixels that are known not to show the ground.
        reach: half the side of the picture.
    """
    chosen = space_evenly(len(cameras), MOST_VIEWS)
    count, world_from_cell = lay_cells(support, reach)
    samples = np.full((len(chosen), count, count, 3), np.nan, np.float32)
    x, y = np.meshgrid(np.arange(count), np.arange(count))

    def sample(place: int, index: int) -> None:
        camera, image = cameras[index], images[index]
        homography = find_homography(camera, world_from_cell)
        back = np.linalg.inv(homography)
        seen = np.ones(image.shape[:2], np.float32) if hidden is None else 1.0 - hidden[index].astype(np.float32)
        seen *= find_in_front(camera, homography)
        row = camera.camera_from_world[2] @ world_from_cell
        visible = (_warp(seen, back, (count, count)) > 0.99) & (row[0] * x + row[1] * y + row[2] > 0)
        samples[place][visible] = _warp(image, back, (count, count))[visible]

    map_in_threads(sample, range(len(chosen)), chosen)
    color, spread, known = take_median(samples)
    return GroundPicture(color, spread, known, world_from_cell, samples)


def find_in_front(camera: Camera, view_from_cell: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose rays meet the plane before the camera, not above its horizon."""
    cell_from_view = np.linalg.inv(view_from_cell)
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    return np.asarray(cell_from_view[2, 0] * x + cell_from_view[2, 1] * y + cell_from_view[2, 2] > 0)  # the inverse of the depth


def find_homography(camera: Camera, world_from_cell: np.ndarray) -> np.ndarray:
    """(3, 3) from positions on a plane, whose (4, 3) map into the world is given, to pixels of a camera, with centres at whole numbers."""
    shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    return np.asarray(shift @ camera.intrinsics @ camera.camera_from_world[:3] @ world_from_cell)


def _warp(image: np.ndarray, homography: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    return cv2.warpPerspective(image, homography, size_px, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def take_median(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median and median deviation over the views of (V, N, N, 3) samples, NaN where one sees nothing; whether enough see a cell."""
    views, count = samples.shape[0], samples.shape[1]
    color, spread, witnesses = _take_median(samples.reshape(views, -1, 3), MIN_WITNESSES)
    return color.reshape(count, count, 3), spread.reshape(count, count), (witnesses >= MIN_WITNESSES).reshape(count, count)


@numba.njit(cache=True, nogil=True)
def _take_median(samples: np.ndarray, least: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    views, cells, _ = samples.shape
    color, spread = np.zeros((cells, 3), np.float32), np.zeros(cells, np.float32)
    witnesses = np.zeros(cells, np.int32)
    values, off, seeing = np.empty(views, np.float32), np.empty(views, np.float32), np.empty(views, np.int64)
    for cell in range(cells):
        count = 0
        for view in range(views):
            if np.isfinite(samples[view, cell, 0]):
                seeing[count] = view
                count += 1
        witnesses[cell] = count
        if count < least:
            continue
        off[:count] = 0
        for channel in range(3):
            for place in range(count):
                values[place] = samples[seeing[place], cell, channel]
            color[cell, channel] = _find_median(values, count)
            for place in range(count):
                off[place] = max(off[place], abs(samples[seeing[place], cell, channel] - color[cell, channel]))
        spread[cell] = _find_median(off, count)
    return color, spread, witnesses


@numba.njit(nogil=True, forceinline=True)
def _find_median(values: np.ndarray, count: int) -> float:
    """Sort the first values by insertion, which is up to four times as fast as np.sort of so few; the lower one of two middle ones."""
    for end in range(1, count):
        value, place = values[end], end
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return float(values[(count - 1) // 2])
