"""Whether two groups of cameras, laid to each other, show the same: their views are compared patch by patch.

Outlines alone cannot tell the two ways apart in which a box fits onto itself, and neither can plain paint, shading and edges: they look
alike in wrong places, too. So that views show something else is judged by patches that lie within the object and are found nowhere else
on it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.register.neighbour_agreement import (
    LEAST_CONTRAST,
    PATCH_PX,
    PLAY_PX,
    SmallView,
    carry_in_place,
    compare_in_place,
    make_small_views,
)
from zeroshop_steps.register.pair_pictures import compare_patches

LARGEST_DEG = 42.0  # between views that are compared
UNLIKE_SCORE = 0.6  # a patch that is found with less is not there
PAIRS, PATCHES, UNLIKE_SHARE = 2, 50, 0.15
"""Groups show the same where so much is compared, and so few patches are missing: up to 0.11 in right ways."""
RIM_PX = 3  # of the small copies: a patch so near to an outline tells nothing that the outlines did not
CHANCE = 0.1  # nor does one that more than this share of the object has the like of
TELLING, WRONG_SHARE = 50, 0.4
"""They show something else where so many telling patches are compared, and more than this share is missing: 0.7 and more in wrong ways of
bottles, up to 0.2 in right ones."""


@dataclass(frozen=True)
class Likeness:
    """How well views of two groups of cameras show the same.

    Attributes:
        pairs, patches: how many were compared.
        score: of the median patch, from -1 to 1.
        unlike_share: of the patches that are found nowhere near.
        telling: how many of the patches tell places of the object apart.
        telling_unlike_share: of these, found nowhere near.
    """

    pairs: int
    patches: int
    score: float
    unlike_share: float
    telling: int
    telling_unlike_share: float

    @property
    def same(self) -> bool:
        """Whether they show the same; False where too little was compared."""
        enough = self.pairs >= PAIRS and self.patches >= PATCHES
        return enough and self.unlike_share <= UNLIKE_SHARE and not self.different

    @property
    def different(self) -> bool:
        """Whether they show something else; False where too little was compared."""
        return self.telling >= TELLING and self.telling_unlike_share > WRONG_SHARE

    def figures(self) -> dict[str, Any]:
        """For the record."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


Chances = dict[tuple[int, int], float]
"""Of the patches of one view by their places (row, column) in its small copy: see `measure_chance`."""


def compare_groups(views: Sequence[View], group: set[str], chances: dict[Path, Chances] | None = None) -> Likeness:
    """Compare views of which one belongs to `group`, by names of images, and the other does not, and that look from similar directions.

    Args:
        views: of both groups, with masks, in one frame.
        group: names of the images of the one group.
        chances: by pictures, what is known of the same views from other ways to lay the groups to each other; completed in place.
    """
    chances = {} if chances is None else chances
    small, pairs, radius = make_small_views(views, LARGEST_DEG)
    scores, telling, compared = [np.zeros(0)], [np.zeros(0)], 0
    for one, other, _ in pairs:
        if (views[one].camera.name in group) != (views[other].camera.name in group):
            ways = [(one, other), (other, one)]
            found = [compare_in_place(small[a], small[b], radius) for a, b in ways]
            compared += any(len(part) for part in found)
            scores += found
            telling += [compare_telling(small[a], small[b], radius, chances.setdefault(views[a].image_path, {})) for a, b in ways]
    every, sure = np.concatenate(scores), np.concatenate(telling)
    score = float(np.median(every)) if len(every) else 0.0
    return Likeness(compared, len(every), score, _share_unlike(every), len(sure), _share_unlike(sure))


def _share_unlike(scores: np.ndarray) -> float:
    return float((scores < UNLIKE_SCORE).mean()) if len(scores) else 0.0


def compare_telling(one: SmallView, other: SmallView, radius: float, chances: Chances) -> np.ndarray:
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
