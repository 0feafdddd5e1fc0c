"""Windows of the images around an object that is small in them: masks are cut there again, at the images' own resolution."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.segment.outlines.outline import follow_edges

SIDE_SIZES = 2.2  # side of a window, in sizes of the mask: the colours around the object are learned there, too
CLOSER = 0.65
"""Where windows are no larger than this share of the images, it is worth looking again. Objects that fill a third of the image stay as
they are."""


class Window(NamedTuple):
    """A part of an image, in its pixels: from left to right and from top to bottom."""

    left: int
    top: int
    right: int
    bottom: int

    def scaled(self, x: float, y: float) -> "Window":
        """The same part of the image at another size, by factors of its width and height."""
        return Window(round(self.left * x), round(self.top * y), round(self.right * x), round(self.bottom * y))

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        return slice(self.top, self.bottom), slice(self.left, self.right)


def take_whole(views: Sequence[View]) -> list[Window]:
    """The whole images."""
    return [Window(0, 0, view.camera.width_px, view.camera.height_px) for view in views]


def choose_windows(masks: Sequence[np.ndarray]) -> tuple[list[Window], float]:
    """Windows around (H, W) bool masks, cut off at the images' borders, and their median side as a share of the images' longer sides.

    An image whose mask is empty, or far larger or smaller than the others, gets one of the usual size around the middle of its mask or of
    itself.
    """
    sizes, middles = [], []
    for mask in masks:
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        empty = not len(rows)
        sizes.append(np.nan if empty else max(np.ptp(rows), np.ptp(columns)) / max(mask.shape))
        middles.append(np.array(mask.shape) / 2 if empty else np.array([rows[0] + rows[-1], columns[0] + columns[-1]]) / 2)
    usual = float(np.nanmedian(sizes))
    windows = []
    for mask, size, (row, column) in zip(masks, sizes, middles, strict=True):
        fits = usual / 2 < size < 2 * usual
        half = SIDE_SIZES * (size if fits else usual) * max(mask.shape) / 2
        (top, bottom), (left, right) = (
            (round(max(middle - half, 0)), round(min(middle + half, length)))
            for middle, length in zip((row, column), mask.shape, strict=True)
        )
        windows.append(Window(left, top, right, bottom))
    return windows, SIDE_SIZES * usual


def scale_windows(windows: Sequence[Window], cameras: Sequence[Camera], views: Sequence[View]) -> list[Window]:
    """Windows in pixels of the views, from those in pixels of cameras that see the whole views at another size."""
    return [
        window.scaled(view.camera.width_px / camera.width_px, view.camera.height_px / camera.height_px)
        for window, camera, view in zip(windows, cameras, views, strict=True)
    ]


def lay_back(mask: np.ndarray, window: Window, view: View) -> np.ndarray:
    """The (H, W) bool mask of a whole image from that of its window, (h, w) float32, above 1/2 on the object; its outline follows edges."""
    whole = np.zeros((view.camera.height_px, view.camera.width_px), bool)
    whole[window.slices] = follow_edges(mask, view.image()[window.slices])
    return whole


def cut_part(photo: np.ndarray, view: View, window: Window) -> np.ndarray:
    """The part of a view's photo, (H, W, 3) of any size, that a window shows; never empty."""
    x, y = photo.shape[1] / view.camera.width_px, photo.shape[0] / view.camera.height_px
    left, top = math.floor(window.left * x), math.floor(window.top * y)
    return photo[top : max(round(window.bottom * y), top + 1), left : max(round(window.right * x), left + 1)]


def resample_map(values: np.ndarray, before: Window, window: Window, view: View, camera: Camera) -> np.ndarray:
    """The part of (h, w) values of one window that lies in another one inside it, of that one's camera's size."""
    x, y = values.shape[1] / (before.right - before.left), values.shape[0] / (before.bottom - before.top)
    columns = (window.left - before.left + (np.arange(camera.width_px) + 0.5) * (window.right - window.left) / camera.width_px) * x - 0.5
    rows = (window.top - before.top + (np.arange(camera.height_px) + 0.5) * (window.bottom - window.top) / camera.height_px) * y - 0.5
    x_map, y_map = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
    return cv2.remap(values, x_map, y_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
