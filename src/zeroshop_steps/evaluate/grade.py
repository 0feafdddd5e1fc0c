"""Grade a finished mesh none, sparse or good, from measurements.

There are two judgements, each decided by its worst measure. The first one needs no truth, so it grades own photos too: registered
photos, silhouettes, parts, open borders, visible backs, roughness, whether the photos agree with one another on the surface, and
how much of the surface was measured. The second one is made where the truth is known: distances to the true surface. Then its
grade is the grade of the cell. An underside that was closed without being seen counts in neither.

Silhouettes and colours are judged in the registered photos, both for rendered and for own captures, so that the limits mean the
same. quality.json has these two figures in held-out photos.

A mesh that was generated without cameras has nothing to be judged by. Its grade is none, and the reason says so.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

from zeroshop_steps.evaluate.grading import MEASURES, GradeResult, check_limits, grade_by_worst
from zeroshop_steps.evaluate.photo_measures import measure_photo_agreement
from zeroshop_steps.evaluate.surface_measures import (
    measure_guessed_share,
    measure_largest_part_share,
    measure_open_boundary,
    measure_roughness_deg,
)
from zeroshop_steps.finish.closing.underside import drop_underside
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.support_classes import compute_area_shares
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.tables import write_table

NOT_GRADED = "not graded: the mesh was generated without cameras, so nothing was measured"


def add_limits(parser: argparse.ArgumentParser) -> None:
    """Options for the limits of each measure."""
    for measure in MEASURES:
        default = [measure.good, measure.sparse]
        option = "--" + measure.name.replace("_", "-")
        parser.add_argument(option, type=float, nargs=2, metavar=("GOOD", "SPARSE"), default=default, help=f"limits: {measure.text}")


def read_limits(args: argparse.Namespace) -> dict[str, tuple[float, float]]:
    """The limits by measure. Raises StepError where one is no pair of limits in the right order."""
    return {measure.name: check_limits(measure.name, getattr(args, measure.name)) for measure in MEASURES}


def judge_mesh(
    mesh: Mesh, metadata: dict, views: list[View], photos: int, quality: dict | None, limits: dict[str, tuple[float, float]],
    outlines_miss_px: float | None = None,
) -> dict:  # fmt: skip
    """The content of grade.json.

    Args:
        mesh: in the object frame, with the support of its surface as quality.
        metadata: content of mesh.json.
        views: the registered photos, their cameras in the object frame.
        photos: how many photos the capture has.
        quality: content of quality.json; None without a truth.
        limits: by measure.
        outlines_miss_px: by how much the outlines of masks that were found miss each other (segment/record.py).
    """
    supported = drop_underside(mesh, metadata)
    values = measure_mesh(supported, views, photos, metadata["frame_facts"]["bottom_z"])
    values["assumed_share"] = compute_area_shares(supported)["assumed"]
    values["guessed_share"] = round(measure_guessed_share(supported, views, find_inferred(metadata)), 5)
    if outlines_miss_px is not None:
        values["outlines_miss_px"] = outlines_miss_px
    true_values = None
    if quality is not None:
        true_values = {measure.name: quality[measure.name] for measure in MEASURES if measure.needs_truth and measure.name in quality}
    return make_grade_record(values, true_values, limits)


def find_inferred(metadata: dict) -> slice:
    """The faces of a hollow that was opened, by the content of mesh.json."""
    hollow = metadata.get("hollow") or {"first_face": 0, "faces": 0}
    return slice(hollow["first_face"], hollow["first_face"] + hollow["faces"])


def measure_mesh(mesh: Mesh, views: list[View], photos: int, support_z: float) -> dict[str, float]:
    """The measures that need no truth.

    Args:
        mesh: in the object frame, z up; only its shape is used.
        views: the registered photos, their cameras in the object frame.
        photos: how many photos the capture has.
        support_z: height of the support in the object frame.
    """
    cameras = [view.camera for view in views]
    below = sum(camera.centre_in_world[2] < support_z for camera in cameras)
    agreement = asdict(measure_photo_agreement(mesh, views))
    values = agreement | {
        "registered_share": len(views) / photos,
        "largest_part_share": measure_largest_part_share(mesh),
        "open_boundary_diameters": measure_open_boundary(mesh, cameras, None if below >= AGREEING_VIEWS else support_z),
        "roughness_deg": measure_roughness_deg(mesh),
    }
    return {name: round(float(value), 5) for name, value in values.items()}


def make_grade_record(values: dict[str, float], true_values: dict[str, float] | None, limits: dict[str, tuple[float, float]]) -> dict:
    """The content of grade.json: the grade of the cell, and both judgements with their measures."""
    photos = grade_by_worst(values, limits)
    truth = None if true_values is None else grade_by_worst(true_values, limits)
    deciding = truth or photos
    return {
        "grade": deciding.grade,
        "judged_by": "truth" if truth else "photos",
        "reasons": list(deciding.reasons),
        "photos": _record_side(photos, values),
        "truth": _record_side(truth, true_values) if truth and true_values else None,
        "limits": {name: list(pair) for name, pair in limits.items()},
    }


def make_ungraded_record(limits: dict[str, tuple[float, float]]) -> dict:
    """The content of grade.json of a mesh that nothing judges."""
    content = {"grade": "none", "judged_by": "nothing", "reasons": [NOT_GRADED], "photos": None, "truth": None}
    return content | {"limits": {name: list(pair) for name, pair in limits.items()}}


def write_grade(path: Path, content: dict) -> None:
    """Write grade.json and, beside it, the tidy CSV: the grades with their reasons, then one row per measurement.

    The measurements against the truth are in quality.csv.
    """
    write_json(path, content)
    rows = [("grade", content["grade"], "; ".join(content["reasons"]))]
    for side in ("photos", "truth"):
        if content[side]:
            rows.append((f"grade_by_{side}", content[side]["grade"], "; ".join(content[side]["reasons"])))
    if content["photos"]:
        rows += [(name, value, "") for name, value in content["photos"]["measures"].items()]
    columns = ["measure", "value", "reason"]
    write_table(path.with_suffix(".csv"), [dict(zip(columns, row, strict=True)) for row in rows])


def _record_side(verdict: GradeResult, values: dict[str, float]) -> dict:
    return {"grade": verdict.grade, "reasons": list(verdict.reasons), "measures": values}
