"""Compare patches that tell places of an object apart.

Plain paint, shading and edges look alike in wrong places, too. So that views show something else is judged by patches that lie within the
object and are found nowhere else on it.
"""

import cv2
import numpy as np

from zeroshop_steps.register.photometry.hull_transfer import LEAST_CONTRAST, PATCH_PX, PLAY_PX, carry_in_place
from zeroshop_steps.register.photometry.hull_views import SmallView
from zeroshop_steps.register.photometry.patches import compare_patches

UNLIKE_SCORE = 0.6  # a patch that is found with less is not there
RIM_PX = 3  # of the small copies: a patch so near to an outline tells nothing that the outlines did not
CHANCE = 0.1  # nor does one that more than this share of the object has the like of


Chances = dict[tuple[int, int], float]
"""Of the patches of one view by their places (row, column) in its small copy: see `measure_chance`."""


def compare_distinctive(one: SmallView, other: SmallView, radius: float, chances: Chances) -> np.ndarray:
    """(P,) scores of the patches that both see, and that tell places of the object apart; the one's chances are completed in place."""
    carried, seen = carry_in_place(one, other, radius)
    own = _find_whole(one.mask)

    def tells(patch: np.ndarray, row: int, column: int) -> bool:
        if (row, column) not in chances:
            chances[row, column] = measure_chance(one.grey, own, patch, row, column)
        return chances[row, column] <= CHANCE

    return compare_patches(one.grey, carried, own & _find_whole(seen), PATCH_PX, PLAY_PX, LEAST_CONTRAST, tells)


def _find_whole(seen: np.ndarray) -> np.ndarray:
    """(H, W) bool, where a patch, and `RIM_PX` around it, is wholly seen."""
    around = np.ones((PATCH_PX + 2 * RIM_PX,) * 2, np.uint8)
    whole: np.ndarray = cv2.erode(seen.astype(np.uint8), around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return whole > 0


def measure_chance(grey: np.ndarray, places: np.ndarray, patch: np.ndarray, row: int, column: int) -> float:
    """In which share of the other places of its own picture a patch would be found.

    Args:
        grey: (H, W) float32 picture.
        places: (H, W) bool, centres of patches on the object.
        patch: of the picture, with its centre at `row` and `column`.
    """
    half, play = PATCH_PX // 2, np.ones((2 * PLAY_PX + 1, 2 * PLAY_PX + 1), np.uint8)
    scores = np.full(grey.shape, -1.0, np.float32)
    scores[half:-half, half:-half] = cv2.matchTemplate(grey, patch, cv2.TM_CCOEFF_NORMED)
    near = PATCH_PX + PLAY_PX
    scores[max(0, row - PATCH_PX) : row + PATCH_PX + 1, max(0, column - PATCH_PX) : column + PATCH_PX + 1] = -1.0
    elsewhere = places.copy()
    elsewhere[max(0, row - near) : row + near + 1, max(0, column - near) : column + near + 1] = False
    if not elsewhere.any():
        return 1.0
    return float((cv2.dilate(scores, play)[elsewhere] >= UNLIKE_SCORE).mean())
