"""Tell objects from the ground: compare each image with an image of the bare support plane, made from all images.

Most views see each point of the plane, even with objects on it. So the median over the views shows the plane alone, with its
shadows. A pixel that differs from it shows an object: background subtraction, with homographies of the plane in place of a fixed
camera.
"""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.channels import measure_length, sum_channels, take_largest, take_least
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.thread_pool import map_in_threads
from zeroshop_steps.segment.ground_structure import find_other_structure, find_risen_plain, measure_print

# Lengths are shares of the cameras' distance from the focus, colours are levels of 255, odds are natural logarithms.
# All were set by hand on the kitchen photos, the DTU skull and rendered films (docs/results.md).
REACH_DISTANCES = 0.9  # half the side of the square of the plane that the image covers
CELL_DISTANCES = 0.004  # side of one of its cells: about a pixel at 480 px of image width
MIN_WITNESSES = 3  # views that must see a cell; with two, an object in one of them is not outvoted
NOISE_LEVELS = 5.0  # of the camera, added to what the views show
SPREAD_WEIGHT = 1.5  # a median deviation is about two thirds of a standard deviation
SHIFT_PX = 1  # errors of the cameras and of the ground's flatness: a pixel may look like its neighbours in the ground's image
SAME_SIGMAS, OTHER_SIGMAS = 1.0, 3.0  # up to the first a colour is the ground's, from the second on it is not
MOST_ODDS = 1.5  # of a pixel for or against an object; single pixels are never certain
LIGHT_ODDS = 0.7  # for an object where only the brightness differs: more often a shadow or a reflection
LIGHT_RANGE = (0.55, 1.7)  # of the brightness in which a colour still counts as the ground's
LIGHT_WINDOW_PX = 11  # over which that brightness is estimated
NO_GROUND_SPREAD = 40.0
"""Where the views differ by this much, the cell shows no ground: a pixel that differs there says nothing."""
SURELY_PRINTED = 0.5  # from here on, plain places are no ground
GAIN_RANGE = (0.4, 2.5)  # of an image's exposure and white balance, for each channel; beyond, the image shows something else
GAIN_STEP = 4  # cells of the coarser image that is enough to estimate them


@dataclass(frozen=True)
class GroundPicture:
    """The picture of the plane.

    Attributes:
        color: (N, N, 3) float32 RGB, 0 to 255: median over the views.
        spread: (N, N) float32: median deviation of the views from it.
        known: (N, N) bool: enough views see the cell.
        world_from_cell: (4, 3): homogeneous cell position (x, y, 1) to a homogeneous point of the plane.
        printed: from 0 to 1, how far the views show the same print on it, so that other structure is told from it.
    """

    color: np.ndarray
    spread: np.ndarray
    known: np.ndarray
    world_from_cell: np.ndarray
    printed: float = 0.0

    def view_from_cell(self, camera: Camera) -> np.ndarray:
        """(3, 3) homography from cells to the pixels of a view, pixel centres at whole numbers."""
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
        return shift @ camera.intrinsics @ camera.camera_from_world[:3] @ self.world_from_cell

    def see_cells(self, cells: np.ndarray, camera: Camera) -> np.ndarray:
        """(H, W) float32 in [0, 1]: how far a view's pixels look at (N, N) bool cells."""
        homography = self.view_from_cell(camera)
        size = (camera.width_px, camera.height_px)
        seen = cv2.warpPerspective(cells.astype(np.float32), homography, size, flags=cv2.INTER_LINEAR)
        return np.where(find_in_front(camera, homography), seen, 0.0).astype(np.float32)

    def evidence(self, camera: Camera, image: np.ndarray, structure_odds: float = 0.0) -> np.ndarray:
        """(H, W) float32 log odds, at most `MOST_ODDS` either way, that a pixel shows an object; 0 where the ground is unknown.

        A colour that differs from the ground's speaks for an object. One that agrees speaks against it, and more so where the ground
        accepts few colours.

        Args:
            camera: of the view.
            image: (H, W, 3) float32 RGB, 0 to 255.
            structure_odds: log odds, at least, where a printed ground's structure is not seen; with 0 it only takes back what colours that
                agree by chance say against an object.
        """
        homography = self.view_from_cell(camera)
        size = (camera.width_px, camera.height_px)
        expected, spread, known = (
            cv2.warpPerspective(part, homography, size, flags=cv2.INTER_LINEAR)
            for part in (self.color, self.spread, self.known.astype(np.float32))
        )
        sigma = NOISE_LEVELS + SPREAD_WEIGHT * spread
        window = np.ones((2 * SHIFT_PX + 1,) * 2, np.uint8)
        highest, lowest = cv2.dilate(expected, window), cv2.erode(expected, window)
        off = measure_length(np.maximum(np.maximum(image - highest, lowest - image), 0)) / sigma
        # The ground's colour in other light: the photographer's shadow, a lamp's reflection.
        both, own = (cv2.blur(sum_channels(part * expected), (LIGHT_WINDOW_PX,) * 2) for part in (image, expected))
        light = np.clip(both / np.maximum(own, 1.0), *LIGHT_RANGE)[..., None]
        off_in_any_light = measure_length(np.maximum(np.maximum(image - light * highest, light * lowest - image), 0)) / sigma
        accepted = (sum_channels(highest - lowest) / 3 + 4 * sigma) / 255.0  # of each channel's range; colours vary in about two dimensions
        against = np.log(np.minimum(accepted, 1.0) ** 2) / 2
        against = np.maximum(against, -MOST_ODDS)
        share, other_color = (np.clip((value - SAME_SIGMAS) / (OTHER_SIGMAS - SAME_SIGMAS), 0, 1) for value in (off, off_in_any_light))
        odds = (1 - share) * against + share * (LIGHT_ODDS + other_color * (MOST_ODDS - LIGHT_ODDS))
        odds *= np.where(odds > 0, np.clip(1 - spread / NO_GROUND_SPREAD, 0, 1), 1)
        if self.printed:
            other = self.printed * find_other_structure(image, expected)
            odds += other * (np.maximum(odds, structure_odds) - odds)
        return np.where((known > 0.99) & find_in_front(camera, homography), odds, 0.0).astype(np.float32)


def build_ground_picture(
    support: SceneSupport, cameras: list[Camera], images: list[np.ndarray], hidden: list[np.ndarray] | None = None
) -> GroundPicture:
    """The median image of the plane.

    Args:
        images: (H, W, 3) float32 RGB of the cameras' sizes.
        hidden: (H, W) bool for each view: pixels that are known not to show the ground.
    """
    picture, samples = sample_ground(support, cameras, images, hidden)
    printed = measure_print(picture.color, picture.known, samples)
    known = picture.known
    if printed > SURELY_PRINTED:
        known = known & ~find_risen_plain(picture.color, known, samples)
    return replace(picture, printed=printed, known=known)


def lay_cells(support: SceneSupport, reach_distances: float = REACH_DISTANCES, step: int = 1) -> tuple[int, np.ndarray]:
    """The number N of cells along each side of the ground's picture, and (4, 3) `world_from_cell`; arguments as of `sample_ground`."""
    count = round(2 * reach_distances / CELL_DISTANCES / step)
    axes, cell = support.axes(), CELL_DISTANCES * step * support.distance
    origin = support.foot - reach_distances * support.distance * axes.sum(0) + cell / 2 * axes.sum(0)
    world_from_cell = np.zeros((4, 3))
    world_from_cell[:3] = np.stack([cell * axes[0], cell * axes[1], origin], axis=1)
    world_from_cell[3, 2] = 1.0
    return count, world_from_cell


def sample_ground(
    support: SceneSupport,
    cameras: list[Camera],
    images: list[np.ndarray],
    hidden: list[np.ndarray] | None,
    reach_distances: float = REACH_DISTANCES,
    step: int = 1,
) -> tuple[GroundPicture, np.ndarray]:
    """The image with cells of `step` times the usual size, and (V, N, N, 3) what each view sees there, NaN where it sees nothing."""
    count, world_from_cell = lay_cells(support, reach_distances, step)
    ground = GroundPicture(np.zeros(0), np.zeros(0), np.zeros(0), world_from_cell)
    samples = np.full((len(cameras), count, count, 3), np.nan, np.float32)

    def sample(index: int, camera: Camera, image: np.ndarray) -> None:
        homography = ground.view_from_cell(camera)
        back = np.linalg.inv(homography)
        seen = np.ones(image.shape[:2], np.float32) if hidden is None else 1.0 - hidden[index].astype(np.float32)
        seen *= find_in_front(camera, homography)
        flags: dict[str, Any] = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_CONSTANT, "borderValue": 0}
        visible = cv2.warpPerspective(seen, back, (count, count), **flags) > 0.99
        visible &= _find_cells_in_front(camera, world_from_cell, count)
        samples[index][visible] = cv2.warpPerspective(image, back, (count, count), **flags)[visible]

    map_in_threads(sample, range(len(cameras)), cameras, images)
    return GroundPicture(*take_median(samples), world_from_cell), samples


def equalize_exposure(support: SceneSupport, cameras: list[Camera], images: list[np.ndarray]) -> list[np.ndarray]:
    """Scale each channel of each image so that all images agree on the ground: exposure and white balance differ between photos."""
    ground, samples = sample_ground(support, cameras, images, None, step=GAIN_STEP)
    steady = ground.known & (ground.spread < NO_GROUND_SPREAD / 2) & (take_least(ground.color) > 10) & (take_largest(ground.color) < 250)
    gained = []
    for image, sample in zip(images, samples, strict=True):
        cells = steady & np.isfinite(sample[..., 0]) & (take_least(np.nan_to_num(sample)) > 5)
        gain = np.median(ground.color[cells] / sample[cells], axis=0) if cells.sum() > 50 else np.ones(3)
        gained.append((image * np.clip(gain, *GAIN_RANGE)).astype(np.float32))
    return gained


def find_in_front(camera: Camera, view_from_cell: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose rays meet the plane before the camera, not above its horizon."""
    cell_from_view = np.linalg.inv(view_from_cell)
    # The third coordinate is the inverse of the depth.
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    w = cell_from_view[2, 0] * x + cell_from_view[2, 1] * y + cell_from_view[2, 2]
    return w > 0


def _find_cells_in_front(camera: Camera, world_from_cell: np.ndarray, count: int) -> np.ndarray:
    x, y = np.meshgrid(np.arange(count), np.arange(count))
    row = camera.camera_from_world[2] @ world_from_cell
    return row[0] * x + row[1] * y + row[2] > 0


def take_median(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median over the views, median deviation from it, and whether enough views see the cell; NaN marks what a view does not see."""
    count = np.isfinite(samples[..., 0]).sum(0)
    middle = np.maximum(count - 1, 0) // 2

    def median(values: np.ndarray) -> np.ndarray:
        ordered = np.sort(values, axis=0)  # NaN goes last
        return np.take_along_axis(ordered, middle[None, ..., *(None,) * (values.ndim - 3)], axis=0)[0]

    color = median(samples)
    spread = median(take_largest(np.abs(samples - color)))
    known = count >= MIN_WITNESSES
    return np.where(known[..., None], color, 0).astype(np.float32), np.where(known, spread, 0).astype(np.float32), known
