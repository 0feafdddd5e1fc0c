"""Windows of the images around an object that is small in them: masks are cut there again, at the images' own resolution."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.runtime.thread_pool import map_in_threads
from zeroshop_steps.segment.outline import follow_edges

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


def cut_views(views: Sequence[View], windows: Sequence[Window], width_px: int) -> tuple[list[Camera], list[np.ndarray]]:
    """Cameras and (H, W, 3) float32 RGB images of the windows, at most `width_px` wide and never enlarged.

    Those higher than wide have as many pixels as a square one: an object is not smaller in a photo in portrait format.
    """
    cameras = []
    for view, window in zip(views, windows, strict=True):
        width, height = window.right - window.left, window.bottom - window.top
        part = view.camera.cropped(window.left, window.top, width, height)
        size = min(round(width_px * min(1.0, math.sqrt(width / height))), width)
        cameras.append(part.resized(size, round(height * size / width)))

    def cut(view: View, window: Window, camera: Camera) -> np.ndarray:
        size_px = (camera.width_px, camera.height_px)
        return cv2.resize(view.image()[window.slices], size_px, interpolation=cv2.INTER_AREA).astype(np.float32)

    return cameras, map_in_threads(cut, views, windows, cameras)


def cut_map(values: np.ndarray, window: Window, view: View, camera: Camera) -> np.ndarray:
    """The part of (h, w) values of a whole image that lies in a window, resampled to the size of its camera."""
    scale_x, scale_y = values.shape[1] / view.camera.width_px, values.shape[0] / view.camera.height_px
    x = (window.left + (np.arange(camera.width_px) + 0.5) * (window.right - window.left) / camera.width_px) * scale_x - 0.5
    y = (window.top + (np.arange(camera.height_px) + 0.5) * (window.bottom - window.top) / camera.height_px) * scale_y - 0.5
    columns, rows = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return cv2.remap(values, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def lay_back(mask: np.ndarray, window: Window, view: View) -> np.ndarray:
    """The (H, W) bool mask of a whole image from that of its window, (h, w) float32, above 1/2 on the object; its outline follows edges."""
    whole = np.zeros((view.camera.height_px, view.camera.width_px), bool)
    whole[window.slices] = follow_edges(mask, view.image()[window.slices])
    return whole
