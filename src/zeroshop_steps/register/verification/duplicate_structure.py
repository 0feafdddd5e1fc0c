"""Refuse a model in which sides that look alike were laid onto each other: too many neighbouring images share almost no points."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.register.scene.record import Evidence, Finding
from zeroshop_steps.register.verification.covisibility import count_covisible_points
from zeroshop_steps.register.verification.missing_correspondences import find_mismatched_pairs

SHARED_POINTS = 0.22
"""Neighbours are not covisible where they share less than this share of what both should see: up to 0.21 where one of two images belongs to
another side of the object, nearly always 0.23 to 0.9 in right models."""
NONCOVISIBLE_PAIRS, NONCOVISIBLE_SHARE = 2, 0.35
"""So many pairs of neighbours may share so little, or this share of all. Where the object alone gave the matches, the first counts not."""
DOUBTFUL_SHARE = 0.1
"""From this share of such neighbours on, the pictures of a whole scene are asked: below, print holds the photos to each other."""
UNLIKE_SHARE, LEAST_COMPARED = 0.26, 5
"""Pictures of neighbours may differ in this share of the pairs, and speak only where so many could be compared: 0 to 0.22 in right models,
0.33 to 0.5 in wrong ones."""

MayMatch = Callable[[str, str], bool]
"""Whether two images, by name, may show the same after all: they match, or were never matched."""


def check_duplicate_structure(
    model: pycolmap.Reconstruction,
    may_match: MayMatch | None = None,
    by_object: bool = False,
    images: Path | None = None,
) -> Evidence:
    """How many neighbouring images there are, and which of them share almost nothing.

    Args:
        model: its images are named STEM.png.
        may_match: is asked about neighbours that share almost no points of the model, by the stems of their names.
        by_object: whether the object alone gave the matches; no ground tells its sides apart then.
        images: the folder of the model's images, where the whole scene gave the matches: these decide where many neighbours share nothing.
    """
    covisible = count_covisible_points(model)
    neighbours, apart = covisible.find_noncovisible(SHARED_POINTS)
    stems = [Path(name).stem for name in covisible.names]
    pairs = [(stems[one], stems[other]) for one, other in np.argwhere(np.triu(apart))]
    strangers = [pair for pair in pairs if may_match is None or not may_match(*pair)]
    entries: dict[str, Any] = {"neighbours": neighbours, "strangers": [list(pair) for pair in strangers]}
    if images is not None and len(strangers) > max(NONCOVISIBLE_PAIRS, DOUBTFUL_SHARE * neighbours):
        compared, unlike = find_mismatched_pairs(model, images)
        entries |= {"compared_pictures": compared, "unlike": [list(pair) for pair in unlike]}
        if compared >= LEAST_COMPARED:
            differ = describe_pairs(unlike, compared, "show different things where they should show the same")
            return Evidence(entries, (Finding("correspondences", len(unlike) / (UNLIKE_SHARE * compared), differ),))
    excused = max(0 if by_object else NONCOVISIBLE_PAIRS, NONCOVISIBLE_SHARE * neighbours) + 0.5
    found = describe_pairs(strangers, neighbours, "share almost nothing")
    return Evidence(entries, (Finding("covisibility", len(strangers) / excused, found),))


def describe_pairs(pairs: Sequence[tuple[str, str]], neighbours: int, what: str) -> str:
    """How many pairs of neighbours are wrong, and in what."""
    example = f", such as {' and '.join(pairs[0])}," if pairs else ""
    return f"{len(pairs)} of {neighbours} pairs of neighbouring images{example} {what}"
