"""How well a patch of one picture is found in another that shows the same place: normalized cross-correlation.

All comparisons of two views end here; `transfer` carries what one view shows into the other before.
"""

from collections.abc import Callable

import cv2
import numpy as np

LEAST_CONTRAST = 5.0  # standard deviation of a patch's grey, of 255, to be compared
WHOLE = 0.95  # share of a patch that must be on the object in both pictures
LEAST_CORRELATION, LEAST_LEAD, PEAK_PX = 0.8, 0.2, 3
"""A patch is found where it correlates so well, and by so much better than anywhere farther off than this. Half of the lead gave twice as
many matches of clamps, and worse cameras."""


def correlate(window: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """(S, T) scores from -1 to 1 of a patch at all places in a window that hold it wholly."""
    return np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED))


def compare_patches(
    grey: np.ndarray,
    carried: np.ndarray,
    whole: np.ndarray,
    patch_px: int,
    play_px: int,
    tells: Callable[[np.ndarray, int, int], bool] = lambda patch, row, column: True,
) -> np.ndarray:
    """(P,) normalized cross-correlation of patches with contrast on a grid, each at its best place within the play.

    Args:
        grey, carried: (H, W) float32 pictures of one place.
        whole: (H, W) bool, where a patch of both lies on the object.
        patch_px, play_px: side of a patch, an odd number, and how far it may lie beside its place.
        tells: whether a patch, by itself and its place (row, column), is worth comparing.
    """
    half = patch_px // 2
    reach = half + play_px
    scores = []
    for row in range(reach, grey.shape[0] - reach, half + 1):
        for column in range(reach, grey.shape[1] - reach, half + 1):
            patch = grey[row - half : row + half + 1, column - half : column + half + 1]
            if whole[row, column] and patch.std() >= LEAST_CONTRAST and tells(patch, row, column):
                window = carried[row - reach : row + reach + 1, column - reach : column + reach + 1]
                scores.append(float(correlate(window, patch).max()))
    return np.array(scores)


def find_peak(scores: np.ndarray) -> np.ndarray | None:
    """(2,) where (S, S) scores are best, in fractions of a pixel; None where that is not good, at the border, or not the only place."""
    row, column = np.unravel_index(scores.argmax(), scores.shape)
    best, last = float(scores[row, column]), len(scores) - 1
    if best < LEAST_CORRELATION or row in (0, last) or column in (0, last):
        return None
    elsewhere = scores.copy()
    elsewhere[max(row - PEAK_PX, 0) : row + PEAK_PX + 1, max(column - PEAK_PX, 0) : column + PEAK_PX + 1] = -1.0
    if elsewhere.max() > best - LEAST_LEAD:
        return None
    beside = scores[row, column - 1 : column + 2], scores[row - 1 : row + 2, column]
    return np.array([column, row]) + [_find_vertex(*three.tolist()) for three in beside]


def _find_vertex(before: float, peak: float, after: float) -> float:
    """By how much the vertex of the parabola through three values lies off the middle one, the largest, from -0.5 to 0.5."""
    bend = before - 2 * peak + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


def measure_chance(grey: np.ndarray, places: np.ndarray, patch: np.ndarray, row: int, column: int, play_px: int, found: float) -> float:
    """In which share of the other places of its own picture a patch would be found.

    Args:
        grey: (H, W) float32 picture.
        places: (H, W) bool, centres of patches on the object.
        patch: (P, P) of the picture, with its centre at `row` and `column`.
        play_px: how far it may lie beside a place.
        found: the score from which it counts as found.
    """
    side = len(patch)
    half, near, play = side // 2, side + play_px, np.ones((2 * play_px + 1,) * 2, np.uint8)
    scores = np.full(grey.shape, -1.0, np.float32)
    scores[half:-half, half:-half] = correlate(grey, patch)
    scores[max(0, row - side) : row + side + 1, max(0, column - side) : column + side + 1] = -1.0
    elsewhere = places.copy()
    elsewhere[max(0, row - near) : row + near + 1, max(0, column - near) : column + near + 1] = False
    if not elsewhere.any():
        return 1.0
    return float((cv2.dilate(scores, play)[elsewhere] >= found).mean())
