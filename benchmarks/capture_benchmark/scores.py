"""What came out of a capture, in a word and in numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_benchmark.table import Capture
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_mask

RIGHT_MEDIAN, RIGHT_WORST, WRONG_MEDIAN = 0.95, 0.85, 0.8  # intersections over unions
OUTCOMES = ("right", "rightly refused", "poor", "unmeasured", "wrongly refused", "wrong", "error")
"""From the best to the worst. Poor: accepted, but not right. Unmeasured: accepted, and no reference tells. Wrong: accepted, and it should
have been refused, or its masks show something else."""
UNEXPECTED = "unexpected "  # stands in the reason of an error that no step raised on purpose
SLACK_MEDIAN, SLACK_WORST = 0.005, 0.02  # a mask is worse than earlier from such a loss on


@dataclass(frozen=True)
class MaskScores:
    """Masks against reference masks.

    Attributes:
        overlaps: intersection over union of each photo that has both, by its stem.
        left_out: registered photos without a mask.
    """

    overlaps: Mapping[str, float]
    left_out: int

    def describe(self, prefix: str) -> dict[str, Any]:
        """Columns of the results table: prefix_median, prefix_worst, prefix_worst_photo."""
        if not self.overlaps:
            return {f"{prefix}_median": None, f"{prefix}_worst": None, f"{prefix}_worst_photo": None}
        worst = min(self.overlaps, key=lambda stem: self.overlaps[stem])
        median = float(np.median(list(self.overlaps.values())))
        return {
            f"{prefix}_median": round(median, 4),
            f"{prefix}_worst": round(self.overlaps[worst], 4),
            f"{prefix}_worst_photo": worst,
        }


def compare_masks(masks: Path, registered: Sequence[str], references: Mapping[str, np.ndarray]) -> MaskScores:
    """Compare the masks of a folder, STEM.png, with references; `registered` are the stems of the scene's photos."""
    found = {stem: masks / f"{stem}.png" for stem in registered if (masks / f"{stem}.png").is_file()}
    overlaps = {stem: compute_overlap(read_mask(found[stem]), references[stem]) for stem in sorted(references) if stem in found}
    return MaskScores(overlaps, len(registered) - len(found))


def name_outcome(capture: Capture, refusal: str | None, median: float | None, worst: float | None) -> str:
    """The outcome, one of `OUTCOMES`.

    Args:
        capture: what must come out.
        refusal: why nothing was accepted; None where something was.
        median, worst: intersections over unions with the references; None where there are none.
    """
    if refusal is not None:
        if UNEXPECTED in refusal:
            return "error"
        return "rightly refused" if set(capture.expected) - {"object"} else "wrongly refused"
    if not capture.wants_object:
        return "wrong"
    if median is None or worst is None:
        return "unmeasured"
    if median < WRONG_MEDIAN:
        return "wrong"
    return "right" if median >= RIGHT_MEDIAN and worst >= RIGHT_WORST else "poor"


def find_worse(now: Mapping[str, Any], earlier: Mapping[str, Any]) -> list[str]:
    """What of a capture's row is worse than in an earlier table, in words."""
    worse = []
    ranks = [OUTCOMES.index(row["outcome"]) if row["outcome"] in OUTCOMES else -1 for row in (now, earlier)]
    if ranks[0] > ranks[1] >= 0:
        worse.append(f"{earlier['outcome']} before, {now['outcome']} now")
    for column, slack in (
        ("mask_iou_median", SLACK_MEDIAN),
        ("mask_iou_worst", SLACK_WORST),
        ("mesh_iou_median", SLACK_MEDIAN),
        ("mesh_iou_worst", SLACK_WORST),
    ):
        values = [row.get(column) for row in (now, earlier)]
        if all(value not in (None, "") for value in values) and float(values[0]) < float(values[1]) - slack:
            worse.append(f"{column} {float(values[1]):.3f} before, {float(values[0]):.3f} now")
    return worse
