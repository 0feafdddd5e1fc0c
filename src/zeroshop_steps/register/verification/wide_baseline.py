"""Compare the pictures of views some way apart, where no views lie near enough to each other for `photometric_consistency`.

Of a capture of few views, hardly two lie within its 18 degrees. Up to 42 degrees apart, the visual hull still carries most patches to where
they belong in right models, and those of print that is alike nowhere else on the object tell whether two views show one side. Where the
hull is too large, patches lie elsewhere: so a pair must differ at other depths, too.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.register.photometry.hull_views import make_small_views
from zeroshop_steps.register.photometry.view_similarity import LEAST_PATCHES, UNLIKE_SCORE, Chances, compare, compare_distinctive
from zeroshop_steps.register.scene.record import Evidence
from zeroshop_steps.register.submodels.appearance import LARGEST_DEG, WRONG_SHARE
from zeroshop_steps.register.verification.duplicate_structure import make_fault
from zeroshop_steps.register.verification.photometric_consistency import LEAST_SCORE, SCORE_PER_DEG
from zeroshop_steps.register.verification.photometric_consistency import WRONG_SHARE as WRONG_PAIRS

FEW_COMPARED = 3
"""Pairs of near neighbours: where fewer could be compared in detail, views farther apart are asked."""


def check_wide_baseline(views: Sequence[View], compared_near: int) -> Evidence:
    """Whether views differ that should show the same, where near neighbours gave almost nothing to compare.

    A fault where too many pairs differ, or the median patch of one is not there (`UNLIKE_SCORE`): a wrong model of a can had one such pair
    of eight.

    Args:
        views: the registered views, with masks.
        compared_near: the pairs that `check_photometric_consistency` compared.
    """
    if compared_near >= FEW_COMPARED:
        return Evidence()
    judged, scores = find_inconsistent_wide(views)
    differing = sorted(scores)
    warnings: tuple[str, ...] = ()
    if not judged and not compared_near:
        warnings = (
            "no two neighbouring photos show enough of the same print to be compared: were sides that look alike laid onto each other, only"
            " matches and outlines would tell; look at the mesh, or add pictures in between",
        )
    wrong = len(differing) > WRONG_PAIRS * judged or min(scores.values(), default=1.0) < UNLIKE_SCORE
    entries = {"compared_far_neighbours": judged, "differing": [list(pair) for pair in differing]}
    return Evidence(entries, make_fault(differing, judged, "differ in detail") if wrong else None, warnings)


def find_inconsistent_wide(views: Sequence[View]) -> tuple[int, dict[tuple[str, str], float]]:
    """How many pairs of views up to `LARGEST_DEG` apart have enough telling patches to be judged, and which of them differ.

    Args:
        views: the registered views, with masks.

    Returns:
        The number of pairs; by the stems of those that differ, the score of their median patch at its best depth, from -1 to 1.
    """
    small, pairs, radius = make_small_views(views, LARGEST_DEG)
    judged, differing = 0, {}
    chances: dict[int, Chances] = {view: {} for view in small}
    for one, other, angle_deg in pairs:
        ways = ((small[one], small[other]), (small[other], small[one]))
        telling = np.concatenate([compare_distinctive(*way, radius, chances[a]) for way, a in zip(ways, (one, other), strict=True)])
        if len(telling) < LEAST_PATCHES:
            continue
        judged += 1
        if (telling < UNLIKE_SCORE).mean() > WRONG_SHARE:
            scores = [score for score in (compare(*way, radius) for way in ways) if score is not None]
            score = float(np.mean(scores)) if scores else -1.0
            if score < LEAST_SCORE - SCORE_PER_DEG * angle_deg:
                differing[Path(views[one].camera.name).stem, Path(views[other].camera.name).stem] = score
    return judged, differing
