"""From measurements to a grade: none, sparse or good.

The words are the thesis's: `good` has smooth and complete geometry, `sparse` is inconsistent but usable, `none` is failed
or unusable. Each measure has a limit for good and one for sparse; the worst measure decides, because one hole, one lid or
one wrong camera is enough to make a mesh unusable, however well it does elsewhere.
"""

from collections.abc import Mapping
from dataclasses import dataclass

GRADES = ("none", "sparse", "good")


@dataclass(frozen=True)
class Measure:
    """A figure that a grade depends on.

    Attributes:
        name: with its unit, as in the config; text: what it is.
        good, sparse: the limits up to which (down to which, where `at_least`) the grade is good, or sparse.
        needs_truth: whether it compares with the true surface.
    """

    name: str
    text: str
    good: float
    sparse: float
    at_least: bool = False
    needs_truth: bool = False

    def grade(self, value: float, limits: tuple[float, float]) -> str:
        """The grade that this measure alone allows under `limits`, (good, sparse)."""
        for grade, limit in zip(("good", "sparse"), limits, strict=True):
            if (value >= limit) if self.at_least else (value <= limit):
                return grade
        return "none"


MEASURES = (
    Measure("registered_share", "photos whose camera was found", 0.9, 0.6, at_least=True),
    Measure("silhouette_agreement", "agreement of silhouettes and masks, mean over the registered photos", 0.96, 0.9, at_least=True),
    Measure("largest_part_share", "area of the largest connected part", 0.95, 0.3, at_least=True),
    Measure("open_boundary_diameters", "length of open borders that photos see, away from the underside", 1.5, 20.0),
    Measure("back_share", "pixels on the mesh that show its back", 0.02, 0.15),
    Measure("roughness_deg", "median angle between the normal and its neighbourhood's", 9.0, 20.0),
    Measure("photometric_error", "colour of a photo against the other photos' prediction, of 1", 0.05, 0.12),
    Measure("displaced_share", "surface where another depth explains the photos clearly better", 0.035, 0.4),
    Measure("assumed_share", "surface that neither an outline nor stereo measured", 0.09, 0.5),
    Measure("f_score_1_percent", "F-score at 1 %% of the diameter", 0.8, 0.4, at_least=True, needs_truth=True),
    Measure("recall_1_percent", "seen true surface within 1 %% of the diameter of the mesh", 0.9, 0.4, at_least=True, needs_truth=True),
    Measure("normal_error_deg", "mean angle to the true normals", 35.0, 60.0, needs_truth=True),
)


@dataclass(frozen=True)
class GradeResult:
    """A grade, and for each measure that is not good a line that says why."""

    grade: str
    reasons: tuple[str, ...]


def grade_by_worst(values: Mapping[str, float], limits: Mapping[str, tuple[float, float]]) -> GradeResult:
    """Grade by the worst of the measures in `values`, under the (good, sparse) limits of each."""
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
