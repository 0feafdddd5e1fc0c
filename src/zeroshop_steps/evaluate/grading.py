"""From measurements to a grade: none, sparse or good.

The words are the thesis's: `good` means smooth and complete geometry, `sparse` inconsistent but usable, `none` failed or unusable.
Each measure has a limit of good and a limit of sparse, and the worst measure decides: one hole, one lid or one wrong camera makes a
mesh unusable, however good the rest is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from zeroshop_steps.runtime.errors import StepError

GRADES = ("none", "sparse", "good")


@dataclass(frozen=True)
class GradeMeasure:
    """A figure that the grade depends on.

    Attributes:
        name: as in the config, with its unit; text: what it is, in reasons and reports.
        good, sparse: the default limits of the two grades.
        at_least: whether values must be at least the limit; otherwise they must be at most the limit.
        needs_truth: whether it compares with the true surface.
    """

    name: str
    text: str
    good: float
    sparse: float
    at_least: bool = False
    needs_truth: bool = False

    def grade(self, value: float, limits: tuple[float, float]) -> str:
        """The grade by this measure alone; `limits` are (good, sparse)."""
        for grade, limit in zip(("good", "sparse"), limits, strict=True):
            if (value >= limit) if self.at_least else (value <= limit):
                return grade
        return "none"


# The limits were set on the demo mustard bottle and mug, damaged in planned steps (docs/results.md, "Damage and the grade"),
# so that the grade falls with the damage; those of silhouettes and displaced surface also allow what a mask that is wrong by a pixel and
# true surfaces give. Roughness, assumed and guessed surface were fitted on plain shapes and damaged meshes, and what counts as good by
# truth was made stricter before: no right surface of 212 had normals off by more than 13.3. What
# is sparse by silhouettes and roughness was fitted on 182 meshes there, with one object left out in turn. Displaced surface was set on
# these and on real captures; colours decide none of these, and their limit allows the highlights of clean real captures. By how much
# outlines miss each other was set on 67 sets of found masks: right ones had 0 to 4.3, and once 7.7; the four beyond 8 (9.3 to 12) lacked a
# part of the object or were of bent cameras.
MEASURES = (
    GradeMeasure("registered_share", "photos whose camera was found", 0.9, 0.6, at_least=True),
    GradeMeasure("silhouette_agreement", "agreement of silhouettes and masks, mean over the registered photos", 0.96, 0.7, at_least=True),
    GradeMeasure("outlines_miss_px", "by how much the outlines of the masks miss each other, in px of 1000", 4.0, 8.0),
    GradeMeasure("largest_part_share", "area of the largest connected part", 0.95, 0.3, at_least=True),
    GradeMeasure("open_boundary_diameters", "length of open borders that photos see, away from the underside", 1.5, 20.0),
    GradeMeasure("back_share", "pixels on the mesh that show its back", 0.02, 0.15),
    GradeMeasure("roughness_deg", "median angle between the normal and its neighbourhood's", 8.0, 25.0),
    GradeMeasure("photometric_error", "colour of a photo against the other photos' prediction, of 1", 0.06, 0.12),
    GradeMeasure("displaced_share", "surface where another depth explains the photos clearly better", 0.03, 0.4),
    GradeMeasure("assumed_share", "surface that neither an outline nor stereo measured", 0.2, 0.5),
    GradeMeasure("guessed_share", "surface that nothing measured, deeper than its outlines say", 0.02, 0.5),
    GradeMeasure("f_score_1_percent", "F-score at 1 %% of the diameter", 0.8, 0.4, at_least=True, needs_truth=True),
    GradeMeasure(
        "recall_1_percent", "seen true surface within 1 %% of the diameter of the mesh", 0.9, 0.4, at_least=True, needs_truth=True
    ),
    GradeMeasure("normal_error_deg", "mean angle to the true normals", 16.0, 60.0, needs_truth=True),
    GradeMeasure(
        "largest_error_percent", "99th percentile of the distance to the truth, in %% of the diameter", 4.0, 40.0, needs_truth=True
    ),
)


def check_limits(name: str, limits: Sequence[float]) -> tuple[float, float]:
    """The (good, sparse) limits of a measure. Raises StepError if that of sparse is stricter."""
    measure = next(measure for measure in MEASURES if measure.name == name)
    good, sparse = limits
    if (good < sparse) if measure.at_least else (good > sparse):
        raise StepError(f"finish.grade.{name} is [{good}, {sparse}]; the limit of good comes first and must be the stricter one")
    return good, sparse


@dataclass(frozen=True)
class GradeResult:
    """A grade, and one line for each measure that is not good."""

    grade: str
    reasons: tuple[str, ...]


def grade_by_worst(values: Mapping[str, float], limits: Mapping[str, tuple[float, float]]) -> GradeResult:
    """Grade by the worst of the measures in `values`; `limits` are (good, sparse) of each."""
    worst, reasons = len(GRADES) - 1, []
    for measure in MEASURES:
        if measure.name not in values:
            continue
        value, (good, sparse) = values[measure.name], limits[measure.name]
        grade = measure.grade(value, (good, sparse))
        worst = min(worst, GRADES.index(grade))
        if grade != "good":
            word, limit = ("below" if measure.at_least else "above"), (good if grade == "sparse" else sparse)
            kept = "good" if grade == "sparse" else "sparse"
            reasons.append(f"{grade}: {measure.name} is {value:.4g}, {word} {limit:g}, the limit of {kept} ({measure.text})")
    return GradeResult(GRADES[worst], tuple(reason.replace("%%", "%") for reason in reasons))
