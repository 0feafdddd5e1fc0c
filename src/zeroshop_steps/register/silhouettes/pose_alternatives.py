"""Other places of views that outlines have placed: whether there are any, and whether a view that fits badly belongs there."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from zeroshop_steps.geometry.cameras.viewpoints import SAME_DIRECTION_DEG
from zeroshop_steps.register.silhouettes.coarse_coherence import FARTHEST_PX, measure_misses, try_places
from zeroshop_steps.register.silhouettes.epipolar_tangency import adjust_by_tangents
from zeroshop_steps.register.silhouettes.pose_search import (
    ABOVE_DEG,
    EVERY,
    NARROW,
    USUAL_TOLERANCE,
    PoseHypothesis,
    compute_looks,
    make_places,
    measure_cost,
)
from zeroshop_steps.register.silhouettes.view_poses import Outlines

GRID_DEG, FOLLOWED = 10, 8  # places that are looked at for another one of a view, and those of them that are followed
ABOVE_RANGE_DEG, ANYWHERE_RANGE_DEG = (-10, 80), (-80, 80)
"""Elevations of other places, where views were placed above the object's middle, and anywhere: some lie beyond those of the search."""
MENDINGS, REPLACED_SHARE = 4, 0.2  # how often views are placed anew, and how many of them
MENDED = 0.97  # share of the cost: above, mending is over
MIRROR = np.array([-1.0, -1.0, 1.0, 1.0, 1.0, 1.0])


def find_alternatives(way: PoseHypothesis, outlines: Outlines, elevations_deg: tuple[int, int]) -> np.ndarray:
    """(N,) by how much rays miss where a view is placed elsewhere, at the best place that is not its own; px per 1000 px.

    Small where outlines do not say from where a view was taken: of a bowl from anywhere around it, of a box from either side.

    Args:
        way: of N views, searched for at `elevations_deg`.
        outlines: theirs.
        elevations_deg: `ABOVE_DEG` or `ANYWHERE_DEG`.
    """
    count = len(outlines.counts)
    placed, least = np.arange(count), np.full(count, FARTHEST_PX)
    base = measure_misses(way.views, way.log_focal, placed, outlines, 1)
    for number in range(count):
        own = compute_looks(way.views[number][None], 0.0)[0]
        for views in _lay(way, number, placed, outlines, elevations_deg, own):
            if compute_looks(views[number][None], 0.0)[0] @ own > np.cos(np.radians(SAME_DIRECTION_DEG)):
                continue  # it came home
            misses = measure_misses(views, way.log_focal, placed, outlines, 1)
            least[number] = min(least[number], max(misses[number], float(np.maximum(misses - base, 0).sum() - misses[number])))
    return least


def replace_worst(way: PoseHypothesis, outlines: Outlines, elevations_deg: tuple[int, int]) -> PoseHypothesis:
    """A way in which the views that fit worst are placed anew, against all others, as long as that helps.

    A beam search may place a view on a wrong side, which is found out only by later ones; and these are bent by it.
    """
    for _ in range(MENDINGS):
        dropped = _choose_worst(way, outlines)
        placed = np.setdiff1d(np.arange(len(way.views)), dropped)
        mended = adjust(way, placed, outlines)
        for number in dropped[::-1]:
            placed = np.append(placed, number)
            laid = [replace(mended, views=views) for views in _lay(mended, number, placed, outlines, elevations_deg)]
            mended = adjust(min(laid, key=lambda way: measure_cost(way, placed, outlines)), placed, outlines)
        if mended.cost > MENDED * way.cost:
            return min(way, mended, key=lambda way: way.cost)
        way = mended
    return way


def mirror(way: PoseHypothesis, outlines: Outlines) -> PoseHypothesis:
    """The way that views from afar could not be told from, adjusted: of the object turned inside out, seen from above instead of below.

    Pictures of an object from afar are those of its mirror image through its centre by cameras that are turned by 180 degrees about their
    axes (Necker's reversal); all is then turned about the x axis, so that cameras are upright.
    """
    return adjust(replace(way, views=way.views * MIRROR), np.arange(len(way.views)), outlines)


def adjust(way: PoseHypothesis, placed: np.ndarray, outlines: Outlines) -> PoseHypothesis:
    """The way with these views, and the focal length, adjusted by all their tangents."""
    views, log_focal = way.views, way.log_focal
    for tolerance in (USUAL_TOLERANCE, NARROW):
        views, log_focal, _ = adjust_by_tangents(views, log_focal, placed, outlines, tolerance, 6, True, np.ones(len(placed), bool))
    adjusted = PoseHypothesis(views, log_focal)
    return replace(adjusted, cost=measure_cost(adjusted, placed, outlines))


def _lay(
    way: PoseHypothesis,
    number: int,
    placed: np.ndarray,
    outlines: Outlines,
    elevations_deg: tuple[int, int],
    away_from: np.ndarray | None = None,
) -> Iterator[np.ndarray]:
    """(N, 6) views, with one of them at each of its likeliest places among the placed ones, the likeliest first.

    `away_from`: (3,) direction from the object; places about there are left out.
    """
    places = make_places(ABOVE_RANGE_DEG if elevations_deg == ABOVE_DEG else ANYWHERE_RANGE_DEG, GRID_DEG)
    if away_from is not None:
        places = places[compute_looks(places, 0.0) @ away_from < np.cos(np.radians(SAME_DIRECTION_DEG + GRID_DEG / 2))]
    others = placed[placed != number]
    costs, laid = try_places(number, places, way.views, way.log_focal, others, outlines, EVERY, FOLLOWED)
    for place in np.argsort(costs, kind="stable")[:FOLLOWED]:
        views = way.views.copy()
        views[number] = laid[place]
        for tolerance in (USUAL_TOLERANCE, NARROW):
            views, _, _ = adjust_by_tangents(views, way.log_focal, placed, outlines, tolerance, 6, False, placed == number)
        yield views


def _choose_worst(way: PoseHypothesis, outlines: Outlines) -> np.ndarray:
    """(K,) numbers of the views without which the others miss least, one after the other, the worst first."""
    placed, dropped = np.arange(len(way.views)), list[int]()
    for _ in range(round(REPLACED_SHARE * len(placed))):
        without = [measure_misses(way.views, way.log_focal, np.delete(placed, k), outlines, EVERY).mean() for k in range(len(placed))]
        worst = int(np.argmin(without))
        dropped.append(int(placed[worst]))
        placed = np.delete(placed, worst)
    return np.array(dropped)
