"""Masks by the ground's colours, and where these tell too little of the object, led by its sparse points."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras import SparseModel
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.segment.mask_quality import MasksRejected
from zeroshop_steps.segment.motion_check import ObjectMoved
from zeroshop_steps.segment.object_selection import ObjectSelection
from zeroshop_steps.segment.risen_points import RisenPoints

MOST_DROPPED = 0.1  # share of the masks that may be bad where others gave none, or gave a part only, and something leads these


@dataclass(frozen=True)
class Found:
    """Masks of all views, and where what they show stands.

    Attributes:
        masks: (H, W) bool of the images' sizes.
        record: of their quality.
        support: the plane, and `plain`: whether its surface has but one colour.
        middle, selection: of what stands on it.
    """

    masks: list[np.ndarray]
    record: dict[str, Any]
    support: SceneSupport
    plain: bool
    middle: np.ndarray
    selection: ObjectSelection


def find_with_points(
    views: list[View], model: SparseModel, cluster: RisenPoints | None, find: Callable[[list[np.ndarray] | None], Found]
) -> tuple[Found, list[np.ndarray] | None]:
    """Masks by the ground's colours; where they lack most of the points above the ground, led by these. And the prior, if any.

    Where the colours give no masks, there may be a reason that points do not take away, such as two things. But where they give masks that
    contradict each other, as of a thing of which a part has the ground's colours, those that points lead are taken where the points tie
    the views to each other, and nearly all of the masks agree. Where the colours say that it moved, the points must tie early views to late
    ones.

    Args:
        model, cluster: all points, and those of the object.
        find: the masks on a ground with a prior, (h, w) log odds of each view, or none.
    """
    failure, found = None, None
    try:
        found = find(None)
    except (MasksRejected, ObjectMoved) as error:
        failure = error
    if cluster is None:
        return _choose(found, failure), None
    if found is not None:
        can_help = cluster.are_missed_by(found.masks, views)
    else:
        can_help = cluster.stay(model) if isinstance(failure, ObjectMoved) else cluster.tie(model)
    if not can_help:
        return _choose(found, failure), None
    print("the ground's colours tell too little of the object: most of its points lie outside the masks, or these contradict each other")
    prior = cluster.weigh(views)
    try:
        again = find(prior)
    except StepError as error:
        print(f"the object's points did not help: {error}")
        return _doubt(found, failure, cluster, views), None
    if not cluster.are_covered_by(again.masks, views) or (failure and len(again.record["dropped"]) > MOST_DROPPED * len(views)):
        return _doubt(found, failure, cluster, views), None
    reason = {"without_points": str(failure)} if failure else {}
    return replace(again, record=again.record | {"led_by_points": len(cluster.points), **reason}), prior


def _doubt(found: Found | None, failure: StepError | None, cluster: RisenPoints, views: list[View]) -> Found:
    """The masks, with a warning that they lack much of the points; raises the failure where there are none."""
    found = _choose(found, failure)
    missed = cluster.measure_missed(found.masks, views)
    warn(
        f"the masks may show a part of the object only, or another thing: {missed:.0%} of the points that rise where the cameras look lie"
        " outside them. Look at contact_sheet.png; put the object alone on a ground of other colours, or draw masks"
    )
    return replace(found, record=found.record | {"points_missed": round(missed, 3)})


def _choose(found: Found | None, failure: StepError | None) -> Found:
    """The masks; raises the failure where there are none."""
    if found is None:
        assert failure is not None
        raise failure
    return found
