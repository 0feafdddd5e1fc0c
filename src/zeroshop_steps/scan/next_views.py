"""The next viewpoints: those that see most of what is not measured yet, can be reached, and are near; and when it is enough.

A greedy next-best-view planner (Connolly 1985; Isler et al. 2016): what a view gains comes from the map of the surface. Of views that gain
about as much, the nearest is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.cameras.transforms import make_unit
from zeroshop_steps.geometry.cameras.viewpoints import SAME_DIRECTION_DEG
from zeroshop_steps.scan.reach import Move, Reach
from zeroshop_steps.scan.surface_map import Coverage, SurfaceMap
from zeroshop_steps.scan.viewpoints import ViewSphere

NEARLY = 0.85  # of the best gain: maps are not more exact, and the nearest of these views is taken
ASKED = 16  # views that an arm is asked for at once, from the best down
PROPOSALS = 5
ENOUGH_SHARE = 0.005
"""Of the known surface: if no reachable view gains more, it is enough. What is left then is at the edges of cells."""


@dataclass(frozen=True)
class Proposal:
    """A view to take.

    Attributes:
        move: how it is reached.
        gain: what it would add, in shares of the known surface.
    """

    move: Move
    gain: float


@dataclass(frozen=True)
class Advice:
    """What to do next.

    Attributes:
        proposals: the best first; none where no view that can be reached adds anything.
        enough: whether the scan may end.
        reason: why or why not, in words.
        coverage: how much is known.
    """

    proposals: tuple[Proposal, ...]
    enough: bool
    reason: str
    coverage: Coverage


def propose(
    surface: SurfaceMap, sphere: ViewSphere, reach: Reach, taken: Sequence[np.ndarray], refused: Sequence[np.ndarray] = ()
) -> Advice:
    """Rank viewpoints.

    Args:
        surface: what is known.
        sphere: which viewpoints there are.
        reach: which of them can be reached.
        taken: (4, 4) world_from_camera of the views so far.
        refused: of views that were proposed and could not be taken.
    """
    extent = surface.extent()
    views = sphere.place(extent)
    fresh = _are_fresh(views, [*taken, *refused], extent.centre_m)
    coverage = surface.coverage()
    gains = surface.gains([sphere.camera_at(view) for view in views]) / max(coverage.surface, 1)
    order = [index for index in np.argsort(-gains, kind="stable") if fresh[index] and gains[index] > 0]
    found: list[Proposal] = []
    unreachable = 0
    for first in range(0, len(order), ASKED):
        asked = order[first : first + ASKED]
        if found and gains[asked[0]] < NEARLY * found[0].gain:
            break
        for index, move in zip(asked, reach.plan(views[asked]), strict=True):
            if move is None:
                unreachable += 1
            else:
                found.append(Proposal(move, float(gains[index])))
    near = sorted((one for one in found if one.gain >= NEARLY * found[0].gain), key=lambda one: one.move.cost)
    ranked = (near + [one for one in found if one.gain < NEARLY * found[0].gain])[:PROPOSALS]
    best = found[0].gain if found else 0.0
    enough = bool(taken) and coverage.surface > 0 and best < ENOUGH_SHARE
    return Advice(tuple(ranked), enough, _explain(enough, best, coverage, len(taken), unreachable), coverage)


def _explain(enough: bool, best: float, coverage: Coverage, taken: int, unreachable: int) -> str:
    if not taken:
        return "no view yet"
    if not coverage.surface:
        return "no surface was measured in the box around the object: is the box at the right place, in metres, and is there depth?"
    seen = f"{taken} views, {coverage.well_seen:.0%} of the known surface seen as often as wanted"
    if enough:
        out_of_reach = f"; {unreachable} better views cannot be reached" if unreachable else ""
        return f"enough: {seen}; no reachable view adds more than {best:.1%}{out_of_reach}"
    return f"{seen}; the best view adds up to {best:.0%}"


def _are_fresh(views: np.ndarray, taken: Sequence[np.ndarray], centre_m: np.ndarray) -> np.ndarray:
    """(N,) bool: views from another direction than those that were taken."""
    if not len(taken):
        return np.ones(len(views), bool)
    wanted, had = (make_unit(np.asarray(poses)[:, :3, 3] - centre_m) for poses in (views, taken))
    return np.asarray((wanted @ had.T).max(1) < np.cos(np.radians(SAME_DIRECTION_DEG)))
