"""Why a pass was left out, or brings little, in words for the one who captured it."""

from zeroshop_steps.join.evidence import LARGEST_MISS_PX, SAME_SIDE_DEG, Judgement, PassObservation, measure_turn_deg
from zeroshop_steps.runtime.failures import Failure, how_to_try_again


def explain(number: int, found: list[Judgement]) -> str:
    """Why a pass could not be joined, and what helps."""
    left_out = _leave_out(number)
    if sum(one.verdict != "wrong" for one in found) > 1:
        return f"pass {number} fits to pass 1 in several ways, because sides of the object look alike: {left_out}"
    if not found or (found[0].miss_px > LARGEST_MISS_PX and found[0].elsewhere_px is not None):
        return (
            f"neither print nor outlines of the object in pass {number} fit to pass 1: {left_out}. Film both passes from low enough that"
            " the sides are seen in both, or lay the object on its side; was it the same object, and are the masks right?"
        )
    if found[0].miss_px > LARGEST_MISS_PX:
        return f"print matches, but the outlines of pass {number} contradict those of pass 1: {left_out}. Has the object changed its shape?"
    if found[0].verdict == "wrong":
        return (
            f"the outlines of pass {number} fit to pass 1, but where the passes lie on each other the pictures differ: {left_out}."
            " Take both passes in the same soft light, without highlights; was it the same object?"
        )
    return f"pass {number} fits to pass 1, but too little print shows that it is right: {left_out}"


def explain_repetition(number: int) -> str:
    """Why a pass whose pictures are those of the first was left out."""
    return f"the pictures of pass {number} are those of pass 1: {_leave_out(number)}. Turn the object over and capture it again"


def explain_failure(number: int, failure: Failure) -> str:
    """Why a later pass that has no cameras was left out."""
    return f"pass {number} failed ({failure.reason}): {_leave_out(number)}. {how_to_try_again(failure.place)}"


def explain_first_failure(failure: Failure) -> str:
    """Why nothing was joined: the frame and the height are those of the first pass."""
    return (
        f"pass 1, in whose frame all stand and of which the height is known, failed ({failure.reason}). Capture it again, or give another"
        f" pass alone. {how_to_try_again(failure.place)}"
    )


def explain_joined(number: int, chosen: Judgement, first: PassObservation, other: PassObservation) -> str | None:
    """What a pass that was joined leaves unknown; None where it leaves nothing."""
    if chosen.verdict != "right":
        return (
            f"pass {number} fits to pass 1 in several turns about its upright axis, and in each it has the same shape: one was taken. How"
            " print that only one of the passes shows lies to that of the other stays unknown"
        )
    if measure_turn_deg(chosen.way, first, other) > SAME_SIDE_DEG:
        return None
    return (
        f"in pass {number} the object stands as in pass 1, so its underside stays unknown: both are used, but turn the object over for"
        " the second pass"
    )


def _leave_out(number: int) -> str:
    return f"pass {number} is left out, and what only it shows stays unknown"
