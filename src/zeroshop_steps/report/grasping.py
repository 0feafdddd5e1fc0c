"""The thesis's Table 4.6 in simulation: marks of segmentation and grasp for every object and pose, and their shares.

A mark is `single` where the first attempt did it, `multi` where the second one did, and `fail`. Beside the shares stand the thesis's
(4.4.3 of "ZeroShOP: Zero-shot object pose estimation in unconstrained environments", TU Wien, January 2026), which are of a real robot,
other objects, and other detectors and pose estimators. Writes a CSV, and a page with the marks.
"""

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

import pandas as pd

from zeroshop_steps.report.published.thesis_entries import GRASPS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import atomic_write
from zeroshop_steps.runtime.tables import read_table, write_table

COLUMNS = ("dataset", "models", "friction", "object", "pose", "placement", "turn_deg", "measure", "value", "source")
SINGLE, MULTI, FAIL = "single", "multi", "fail"
SYMBOLS = {SINGLE: "●", MULTI: "○", FAIL: "×"}
SUCCESS = "success"
FIRST, SECOND, ATTEMPTED = "grasps at the first attempt, %", "grasps with a second attempt, %", "poses"
OVERLAP_SEGMENTED, OVERLAP_POSED = "objects segmented where they overlap, %", "of these, grasp poses that are right, %"
CLEAR_SEGMENTED, CLEAR_POSED = "objects segmented where they stand apart, %", "of those that stand apart, grasp poses that are right, %"
SCENES = {"overlapping": (OVERLAP_SEGMENTED, OVERLAP_POSED), "clear": (CLEAR_SEGMENTED, CLEAR_POSED)}
MEASURED, THESIS = "measured", "thesis"
DELIVERED, MISJUDGED = "models_delivered_", "models_misjudged_"
"""What folders of meshes as they were made begin with, and of the same with heights as wrong as the thesis published."""
RESULTS = {
    "no_mesh": "there is no mesh",
    "detect": "not detected",
    "pose": "too little measured for a pose",
    "choose": "no grasp is clear of the table",
    "approach": "the hand was blocked on its approach",
    "close": "the fingers did not both meet the object",
    "lift": "lost while lifting",
    "hold": "lost while holding",
    "shake": "lost while shaking",
}
READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--attempts", type=Path, nargs="+", required=True, help="folders DATASET/bop/grasping/MODELS/OBJECT")
    parser.add_argument("--scenes", type=Path, nargs="*", default=[], help="folders DATASET/bop/sightings/MODELS of several things")
    parser.add_argument("--page", type=Path, required=True, help="Markdown to write")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table and the page."""
    attempts = pd.concat([read_attempts(folder) for folder in args.attempts if not read_failure(folder)], ignore_index=True)
    marks = mark_poses(attempts)
    scenes = [row for folder in args.scenes if not read_failure(folder) for row in sum_scenes(folder)]
    summary = sum_marks(marks) + scenes
    published = [
        {"models": row["models"], "measure": row["measure"], "value": row["value"], "source": THESIS}
        for row in read_table(GRASPS).to_dict("records")
    ]
    write_table(args.out, marks + summary + published, COLUMNS)
    with atomic_write(args.page) as temporary:
        temporary.write_text(make_page(marks, summary + published, attempts))


def read_attempts(folder: Path) -> pd.DataFrame:
    """The attempts of one object with the coordinates of its path. Raises StepError where the path has none."""
    try:
        dataset, bop, grasping, models, name = folder.parts[-5:]
    except ValueError:
        dataset, bop, grasping, models, name = ("",) * 5
    if (bop, grasping) != ("bop", "grasping"):
        raise StepError(f"{folder} is no object's; expected DATASET/bop/grasping/MODELS/OBJECT")
    table = read_table(folder / "attempts.csv").assign(dataset=dataset, models=models, object=name)
    return table.astype({"attempt": int, "pose": int})


def mark_poses(attempts: pd.DataFrame) -> list[dict[str, Any]]:
    """A row for the segmentation and one for the grasp of every pose."""
    rows = []
    keys = ["dataset", "models", "friction", "object", "pose", "placement", "turn_deg"]
    for key, group in attempts.groupby(keys, sort=False):
        place = dict(zip(keys, key, strict=True))
        ordered = group.sort_values("attempt")
        rows.append(place | {"measure": "segmentation", "value": _mark(ordered.segmented == "1"), "source": MEASURED})
        rows.append(place | {"measure": "grasp", "value": _mark(ordered.result == SUCCESS), "source": MEASURED})
    return rows


def _mark(good: pd.Series) -> str:
    """Of one pose's attempts in their order: whether the first, a later one or none went well."""
    return SINGLE if good.iloc[0] else MULTI if good.any() else FAIL


def sum_marks(marks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The shares of all objects with the same models and friction, and of each object alone."""
    rows = []
    grasps = pd.DataFrame([mark for mark in marks if mark["measure"] == "grasp"])
    for keys in (["dataset", "models", "friction"], ["dataset", "models", "friction", "object"]):
        for key, group in grasps.groupby(keys, sort=False):
            place = dict(zip(keys, key, strict=True))
            counts = Counter(group.value)
            figures = {
                FIRST: f"{100 * counts[SINGLE] / len(group):.1f}",
                SECOND: f"{100 * (counts[SINGLE] + counts[MULTI]) / len(group):.1f}",
                ATTEMPTED: str(len(group)),
            }
            rows += [place | {"measure": name, "value": value, "source": MEASURED} for name, value in figures.items()]
    return rows


def sum_scenes(folder: Path) -> list[dict[str, Any]]:
    """The shares of several things on a table: of objects that were segmented, and of these, with a right pose."""
    dataset, models = folder.parts[-4], folder.parts[-1]
    table, rows = read_table(folder / "scenes.csv"), []
    for kind, names in SCENES.items():
        segmented = (table[table.kind == kind].segmented == "1").to_numpy()
        posed = (table[table.kind == kind].pose_right == "1").to_numpy()
        shares = (segmented.mean(), posed[segmented].mean()) if segmented.any() else (0.0, 0.0)
        place = {"dataset": dataset, "models": models, "source": MEASURED}
        rows += [place | {"measure": name, "value": f"{100 * share:.0f}"} for name, share in zip(names, shares, strict=True)]
        rows.append(place | {"measure": f"objects, {kind}", "value": str(len(segmented))})
    return rows


def make_page(marks: list[dict[str, Any]], summary: list[dict[str, Any]], attempts: pd.DataFrame) -> str:
    """The page: shares, marks of every pose, and why attempts failed."""
    lines = ["# Grasps in simulation", "", "The thesis's protocol (Table 4.6) with a simulated robot.", ""]
    lines += [f"{SYMBOLS[SINGLE]} at the first attempt, {SYMBOLS[MULTI]} at the second, {SYMBOLS[FAIL]} not at all.", ""]
    lines += ["| models | friction | source | " + f"{ATTEMPTED} | {FIRST} | {SECOND} |", "|---|---|---|---|---|---|"]
    whole = pd.DataFrame([row for row in summary if not row.get("object")]).fillna("")
    for (models, friction, source), group in whole.groupby(["models", "friction", "source"], sort=False):
        found = dict(zip(group.measure, group.value, strict=True))
        if FIRST in found:
            lines.append(f"| {models} | {friction} | {source} | {found.get(ATTEMPTED, '')} | {found[FIRST]} | {found[SECOND]} |")
    scenes = whole[whole.measure.isin([name for names in SCENES.values() for name in names])]
    if len(scenes):
        lines += ["", "| models | source | measure | value |", "|---|---|---|---|"]
        lines += [f"| {row.models} | {row.source} | {row.measure} | {row.value} |" for row in scenes.itertuples()]
    table = pd.DataFrame(marks)
    for (models, friction), group in table.groupby(["models", "friction"], sort=False):
        lines += [
            "",
            f"## {models}, friction {friction}",
            "",
            "| object | | " + " | ".join(map(str, range(1, 9))) + " |",
            "|---" * 10 + "|",
        ]
        for name, own in group.groupby("object", sort=False):
            for measure, title in (("segmentation", name), ("grasp", "")):
                symbols = own[own.measure == measure].sort_values("pose").value.map(SYMBOLS)
                lines.append(f"| {title} | {measure} | " + " | ".join(symbols) + " |")
        lines += _list_failures(attempts[(attempts.models == models) & (attempts.friction == friction)])
    return "\n".join(lines) + "\n"


def _list_failures(attempts: pd.DataFrame) -> list[str]:
    """How often each stage failed, and in how many of these attempts the pose was off by more than a tenth of the diameter."""
    failed = attempts[attempts.result != SUCCESS]
    if failed.empty:
        return ["", "No attempt failed."]
    wrong = pd.to_numeric(failed.pose_error_diameters, errors="coerce") > 0.1
    lines = ["", "| failed attempts | of them, with a wrong pose | what failed |", "|---|---|---|"]
    for result, count in Counter(failed.result).most_common():
        lines.append(f"| {count} | {int(wrong[failed.result == result].sum())} | {RESULTS.get(result, result)} |")
    return lines
