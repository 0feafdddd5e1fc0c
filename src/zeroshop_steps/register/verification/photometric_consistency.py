"""Compare the pictures of neighbouring views patch by patch: views of sides that look alike, laid onto each other, differ in detail.

Sides with nearly the same print, as the two of a can, agree in matches, masks and reprojection errors, and a cylinder's masks fit any turn.
But views from nearly one direction must show the same all over. Each view is carried into its neighbours along the visual hull of the
masks, and textured patches are compared by normalized cross-correlation: in place, with some play, and at other depths, since the hull
fills what is hollow.

Of a capture of few views, hardly two lie within 18 degrees (wide baseline). Up to 42 degrees apart, the hull still carries most patches to
where they belong in right models, and distinctive patches tell whether two views show one side. Where the hull is too large, patches lie
elsewhere: so a pair must differ at other depths, too.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.register.photometry.hull_views import SmallView, make_small_views
from zeroshop_steps.register.photometry.view_similarity import LEAST_PATCHES, UNLIKE_SCORE, Chances, compare, compare_distinctive
from zeroshop_steps.register.scene.record import Evidence, Finding
from zeroshop_steps.register.submodels.appearance import LARGEST_DEG
from zeroshop_steps.register.submodels.appearance import WRONG_SHARE as WRONG_PATCHES
from zeroshop_steps.register.verification.duplicate_structure import describe_pairs

NEAR_DEG = 18.0  # views are neighbours where their directions to the object differ by at most so much
LEAST_SCORE, SCORE_PER_DEG = 0.92, 0.007
"""Neighbours in one direction should agree to this score, those an angle apart to as much less. Right models: 0.9 and more within 10
degrees, 0.85 and more up to 18, for hollow things 0.8; sides that look alike 0.55 to 0.84."""
WRONG_SHARE = 0.25
"""Of the pairs of neighbours that are judged, this share may disagree: up to 0.05 in right models, 0.5 to 1 in wrong ones. Where few are
judged, no outliers are allowed: a tube of which half of the views were taken came out folded, 284 mm off, with two of two that disagree."""
FEW_COMPARED = 3
"""Pairs of near neighbours: where fewer could be compared in detail, views farther apart are asked."""


def check_photometric_consistency(views: Sequence[View], wide: bool = True) -> Evidence:
    """Whether neighbouring views of the object, with masks, show the same.

    Args:
        views: the registered views, with masks.
        wide: whether views farther apart are asked where near neighbours give almost nothing to compare.
    """
    judged, differing = find_inconsistent(views)
    entries: dict[str, Any] = {"compared_neighbours": judged, "disagreeing": [list(pair) for pair in differing]}
    warnings: tuple[str, ...] = ()
    if wide and judged < FEW_COMPARED:
        far, scores = find_inconsistent_wide(views)
        entries |= {"compared_far_neighbours": far, "differing": [list(pair) for pair in sorted(scores)]}
        judged, differing = judged + far, [*differing, *sorted(scores)]
        if not judged:
            warnings = (
                "no two neighbouring photos show enough of the same print to be compared: were sides that look alike laid onto each other,"
                " only matches and outlines would tell; look at the mesh, or add pictures in between",
            )
    strength = len(differing) / (WRONG_SHARE * judged) if judged else 0.0
    return Evidence(entries, (Finding("photometry", strength, describe_pairs(differing, judged, "differ in detail")),), warnings=warnings)


def find_inconsistent(views: Sequence[View]) -> tuple[int, list[tuple[str, str]]]:
    """How many pairs of neighbours were judged, and the stems of those whose pictures do not show the same.

    Args:
        views: the registered views, with masks.
    """
    small, pairs, radius = make_small_views(views, NEAR_DEG)
    judged, disagreeing = 0, []
    for one, other, angle_deg in pairs:
        score = _compare_both_ways(small[one], small[other], radius)
        if score is None:
            continue
        judged += 1
        if score < LEAST_SCORE - SCORE_PER_DEG * angle_deg:
            disagreeing.append((Path(views[one].camera.name).stem, Path(views[other].camera.name).stem))
    return judged, disagreeing


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
        if (telling < UNLIKE_SCORE).mean() > WRONG_PATCHES:
            score = _compare_both_ways(small[one], small[other], radius)
            score = -1.0 if score is None else score
            if score < LEAST_SCORE - SCORE_PER_DEG * angle_deg:
                differing[Path(views[one].camera.name).stem, Path(views[other].camera.name).stem] = score
    return judged, differing


def _compare_both_ways(one: SmallView, other: SmallView, radius: float) -> float | None:
    scores = [score for score in (compare(one, other, radius), compare(other, one, radius)) if score is not None]
    return float(np.mean(scores)) if scores else None
