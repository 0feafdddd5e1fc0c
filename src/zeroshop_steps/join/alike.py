"""Plain things whose shape stays the same when they are turned about their upright axis: a bowl that was put upside down.

Such a pass fits to another in several ways, and where what both passes see has no print, nothing tells which is true. The shape needs no
telling: it is the same in every way, if the outlines of each pass still fit after the turn between two ways. Then any way will do. What
stays unknown is how print that one pass alone sees lies to print that the other alone sees. Turns about another axis are never taken,
since they bring together sides that a pass itself did not see.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.transforms import compute_scale
from zeroshop_steps.join.evidence import Judgement, PassObservation
from zeroshop_steps.register.submodels.outline_alignment import measure_misses

AXIS_DEG = 10.0  # of a turn's axis from the pass's up
MISS_PX = 1.0  # by which the outlines of a pass, turned, may miss its own in the mean, per 1000 px
MOST_TELLING = 20  # patches in what both passes see that tell places of the object apart: with more, it has print there


def choose_any(found: list[Judgement], target: PassObservation, source: PassObservation) -> Judgement | None:
    """The way that fits best, where several fit, none is known to be right, and the shape is the same in all; else None."""
    possible = sorted((one for one in found if one.verdict != "wrong"), key=lambda one: one.miss_px)
    if len(possible) < 2 or any(one.verdict == "right" or one.likeness.telling > MOST_TELLING for one in possible):
        return None
    best, *others = possible
    for other in others:
        turns = (
            (source, np.linalg.inv(best.way.target_from_source) @ other.way.target_from_source),
            (target, best.way.target_from_source @ np.linalg.inv(other.way.target_from_source)),
        )
        if not all(fits_itself(*turn) for turn in turns):
            return None
    return best


def fits_itself(sight: PassObservation, turn: np.ndarray) -> bool:
    """Whether a pass has the same outlines after a turn, a (4, 4) similarity in its own frame, about its upright axis."""
    vector = Rotation.from_matrix(turn[:3, :3] / compute_scale(turn)).as_rotvec()
    upright = abs(vector @ sight.group.up) >= np.cos(np.radians(AXIS_DEG)) * np.linalg.norm(vector)
    return bool(upright and measure_misses(sight.group, sight.group, turn).mean() <= MISS_PX)
