"""Segment Anything on windows of photos: each is encoded once, as that takes most of the time, and then asked for any number of masks."""

from collections.abc import Sequence

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.networks.mobile_sam.model import Features, MobileSam
from zeroshop_steps.segment.outlines.windows import Window, cut_part

MARGIN = 0.15  # around a window, of its size, that is encoded with it: windows of later hypotheses lie a little elsewhere
MOST_LONGER = 2.0  # than a window is one that was encoded before and serves for it
POINTS = 3  # of the object: one in each of its largest parts
SAME = 0.98  # overlap of what is asked with what was asked before, from which on the answer is the same
CLEARANCE = 1.5  # between them, of the distance from a point to the outline


class PromptedSegmenter:
    """The network, the windows that it has encoded, and its last answer for each view."""

    def __init__(self, network: MobileSam) -> None:
        self._network = network
        self._encoded: dict[str, list[tuple[Window, Features]]] = {}
        self._answers: dict[str, tuple[Window, np.ndarray, np.ndarray]] = {}

    @property
    def name(self) -> str:
        """The file of the network's weights, for records."""
        return self._network.path.name

    def cut(self, photo: np.ndarray, view: View, window: Window, shown: np.ndarray) -> tuple[Window, np.ndarray]:
        """Masks of the object in a window.

        Args:
            photo: (H, W, 3) uint8 RGB of the whole view, of any size.
            view, window: what it is a photo of, and the part of it that is looked at.
            shown: (h, w) bool, where the object is thought to be in the window.

        Returns:
            The window that the masks are of, which contains the given one; and (2, H, W) float32 log odds: of what fills the box around
            `shown`, and of the largest thing that points in it are part of.
        """
        around, features = self._encode(photo, view, window)
        before = self._answers.get(view.camera.name)
        if before is not None and before[0] == window and compute_overlap(before[1], shown) >= SAME:
            return around, before[2]
        box, points = _describe(shown, window, around)
        boxed = self._network.decode(features, box=box)
        pointed = self._network.decode(features, points=points, labels=np.ones(len(points)))
        masks = np.stack([boxed[-1], pointed[-1]])
        self._answers[view.camera.name] = window, shown, masks
        return around, masks

    def _encode(self, photo: np.ndarray, view: View, window: Window) -> tuple[Window, Features]:
        encoded = self._encoded.setdefault(view.camera.name, [])
        for around, features in encoded:
            if _contains(around, window) and _find_side(around) <= MOST_LONGER * _find_side(window):
                return around, features
        x, y = (round(MARGIN * (end - start)) for start, end in ((window.left, window.right), (window.top, window.bottom)))
        around = Window(
            max(window.left - x, 0),
            max(window.top - y, 0),
            min(window.right + x, view.camera.width_px),
            min(window.bottom + y, view.camera.height_px),
        )
        encoded.append((around, self._network.encode(cut_part(photo, view, around))))
        return encoded[-1]


def _describe(shown: np.ndarray, window: Window, around: Window) -> tuple[np.ndarray, np.ndarray]:
    """The box around (h, w) bool in a window, and (P, 2) points in it, as shares of the width and height of the window around that."""
    rows, columns = np.nonzero(shown)
    corners = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]], float)
    points = np.array(find_inner_points(shown), float)[:, ::-1] + 0.5
    size = np.array(shown.shape[::-1])
    corner, side = np.array(window[:2]), np.array(window[2:]) - window[:2]
    outer_corner, outer_side = np.array(around[:2]), np.array(around[2:]) - around[:2]
    box, inner = ((corner + part / size * side - outer_corner) / outer_side for part in (corners, points))
    return box, inner


def find_inner_points(shown: np.ndarray) -> Sequence[tuple[int, int]]:
    """Row and column of up to `POINTS` pixels of (h, w) bool, farthest from its outline and from each other."""
    depth = cv2.distanceTransform(np.pad(shown.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    rows, columns = np.ogrid[: shown.shape[0], : shown.shape[1]]
    found: list[tuple[int, int]] = []
    while len(found) < POINTS and depth.max() > 0:
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        found.append((int(row), int(column)))
        depth[(rows - row) ** 2 + (columns - column) ** 2 <= (CLEARANCE * depth[row, column]) ** 2] = 0
    return found


def _contains(around: Window, window: Window) -> bool:
    return around.left <= window.left and around.top <= window.top and around.right >= window.right and around.bottom >= window.bottom


def _find_side(window: Window) -> int:
    return max(window.right - window.left, window.bottom - window.top)
