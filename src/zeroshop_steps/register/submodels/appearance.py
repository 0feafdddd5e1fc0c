"""Whether two groups of cameras, laid to each other, show the same: their views are compared patch by patch.

Outlines alone cannot tell the two ways apart in which a box fits onto itself, and neither can plain paint, shading and edges: they look
alike in wrong places, too. So that views show something else is judged by patches that lie within the object and are found nowhere else
on it.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.register.photometry.hull_views import make_small_views
from zeroshop_steps.register.photometry.view_similarity import UNLIKE_SCORE, Chances, compare_distinctive, compare_in_place

LARGEST_DEG = 42.0  # between views that are compared
PAIRS, PATCHES, UNLIKE_SHARE = 2, 50, 0.15
"""Groups show the same where so much is compared, and so few patches are missing: up to 0.11 in right ways."""
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
            telling += [compare_distinctive(small[a], small[b], radius, chances.setdefault(views[a].image_path, {})) for a, b in ways]
    every, sure = np.concatenate(scores), np.concatenate(telling)
    score = float(np.median(every)) if len(every) else 0.0
    return Likeness(compared, len(every), score, _share_unlike(every), len(sure), _share_unlike(sure))


def _share_unlike(scores: np.ndarray) -> float:
    return float((scores < UNLIKE_SCORE).mean()) if len(scores) else 0.0
