"""The sections of an object's page: pictures and cameras of each run, and every stage of each of its cells."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from zeroshop_steps.evaluate.grading import MEASURES
from zeroshop_steps.geometry.cameras.pinhole import make_transform, read_sparse_model
from zeroshop_steps.report.site.advice import advise, advise_on_failure
from zeroshop_steps.report.site.results_index import Cell, Run, find_table, read_facts
from zeroshop_steps.report.site.svg_plots import camera_plan, line_chart
from zeroshop_steps.report.site.viewer_meshes import read_object_frame
from zeroshop_steps.report.site.views import write_sheets, write_views
from zeroshop_steps.runtime.errors import StepError, warn

# Curves that a page shows of a training, in this order, as far as the method has them.
CURVES = ("loss", "l1", "mask", "depth", "normal")
ORDER = (
    *("capture", "segment", "register", "camera_error", "stereo", "train", "fuse", "mesh", "shape", "texture", "outcome", "evaluate"),
    "cell",
)
"""The steps of a cell in their order."""


def make_run_sections(runs: list[Run], folder: Path, changes: str = "") -> list[dict]:
    """What the template of the page needs of every run; pictures are written to `folder`.

    Args:
        changes: the end of the command that makes the cells, which changes the config.
    """
    return [
        {
            "run": run,
            "failed": run.failed,
            "advice": advise_on_failure("register", run.failed) if run.failed else None,
            "sheets": _skip_damaged(write_sheets, run, folder),
            "plan": _draw_plan(run),
            "camera_errors": _read_camera_errors(run),
            "warnings": run.captured.get("warnings") or [],
            "cells": [make_cell_section(cell, run, folder, changes) for cell in run.cells],
        }
        for run in runs
    ]


def make_cell_section(cell: Cell, run: Run, folder: Path, changes: str) -> dict:
    """What the template of the page needs of a cell."""
    return {
        "cell": cell,
        "advice": advise(cell),
        "pictures": _skip_damaged(write_views, cell, run, folder)
        if cell.state != "failed" and (cell.folder / "mesh.ply").is_file()
        else {},
        "held_out": (run.capture / "held_out/truth").is_dir(),
        "measures": list_measures(cell),
        "curves": line_chart(read_training_curves(cell), "iteration", "loss", log_y=True),
        "costs": list_costs(cell, run),
        "provenance": list_provenance(cell, run),
        "command": f"snakemake --cores 2 {cell.folder.parents[4].name}/{cell.folder.parents[3].name}/{cell.folder.parents[2].name}/"
        f"{cell.scene}/{cell.registration}/{cell.nvs}/mesh.ply{changes}",
    }


def _draw_plan(run: Run) -> Markup | None:
    if run.failed or not (run.folder / "cameras/sparse").is_dir():
        return None
    finished = next((cell for cell in run.cells if cell.facts["mesh"].get("frame_facts")), None)
    try:
        model = read_sparse_model(run.folder / "cameras/sparse")
    except StepError:
        return None
    if not model.cameras:
        return None
    if finished:
        return camera_plan(model, read_object_frame(finished), "mm" if finished.facts["mesh"].get("scale") == "known" else "units")
    centred = make_transform(np.eye(3), -np.mean([camera.centre_in_world for camera in model.cameras], axis=0))
    return camera_plan(model, centred, "units of the registration, axes as they came")


def _read_camera_errors(run: Run) -> dict[str, str]:
    rows = find_table(run.folder / "camera_error.csv").itertuples()
    return {row.measure: row.value for row in rows if row.camera == "all"}


def _skip_damaged(write: Callable[..., dict[str, str]], *arguments: Any) -> dict[str, str]:
    """Write pictures; if a file that they need is damaged or missing, warn and write none."""
    try:
        return write(*arguments)
    except StepError as error:
        warn(f"pictures are left out: {error}")
        return {}


def list_costs(cell: Cell, run: Run) -> list[dict]:
    """Seconds, CPU seconds and peak memory of every step of a cell, as Snakemake measured them.

    A step that left no measurement comes with the seconds of its own record, if it has one.
    """
    folders = (run.folder.parent, run.folder, run.folder / "stereo", cell.folder)
    measured = {path.stem: read_tsv(path) for folder in folders for path in sorted((folder / "benchmarks").glob("*.tsv"))}
    rows = [
        {"step": step, "seconds": parse_number(record, "s"), "cpu": parse_number(record, "cpu_time"), "mb": parse_number(record, "max_rss")}
        for step, record in measured.items()
        if record
    ]
    if "register" not in measured and (seconds := run.registered.get("seconds", {}).get("total")) is not None:
        rows.append({"step": "register", "seconds": float(seconds), "cpu": None, "mb": None})
    return sorted(rows, key=lambda row: (ORDER.index(row["step"]) if row["step"] in ORDER else len(ORDER), row["step"]))


def read_tsv(path: Path) -> dict[str, str]:
    """The last measurement in a benchmark file; empty if it is damaged."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return dict(zip(lines[0].split("\t"), lines[-1].split("\t"), strict=False)) if len(lines) > 1 else {}


def parse_number(record: dict[str, str], name: str) -> float | None:
    """A figure of a benchmark file; None if Snakemake could not measure it."""
    try:
        return float(record[name])
    except (KeyError, ValueError):
        return None


def list_measures(cell: Cell) -> list[dict]:
    """The measures of a cell's grade, with their limits and the grade by each alone."""
    judged, limits = cell.facts["grade"], cell.facts["grade"].get("limits", {})
    rows = []
    for measure in MEASURES:
        value = cell.figures.get(measure.name)
        if value is None or measure.name not in limits:
            continue
        counts = measure.needs_truth == (judged.get("judged_by") == "truth")
        grade = measure.grade(value, tuple(limits[measure.name]))
        text = measure.text.replace("%%", "%")
        rows.append({"text": text, "name": measure.name, "value": value, "grade": grade, "counts": counts, "limits": limits[measure.name]})
        rows[-1]["sign"] = "≥" if measure.at_least else "≤"
    return sorted(rows, key=lambda row: not row["counts"])


def read_training_curves(cell: Cell) -> dict[str, list[tuple[float, float]]]:
    """The losses of a training over its iterations."""
    path = next((path for path in (cell.folder / "splats/training.csv", cell.folder / "voxels/training.csv") if path.is_file()), None)
    table = find_table(path) if path else pd.DataFrame()
    curves = {name: table[table[name] != ""][["iteration", name]].astype(float) for name in CURVES if name in table}
    return {name: list(curve.itertuples(index=False, name=None)) for name, curve in curves.items()}


def list_provenance(cell: Cell, run: Run) -> list[tuple[str, str]]:
    """Names and texts of the parameters and records of a cell's steps."""
    mesh, training = cell.facts["mesh"], cell.facts["training"]
    records = {
        "model": read_facts(cell.folder.parents[2] / "model/model_info.json").get("source"),
        "versions": mesh.get("versions") or run.registered.get("versions"),
        "pictures": run.captured,
        "parameters": mesh.get("parameters") or run.registered.get("parameters"),
        "training": training.get("settings"),
        "given depth": mesh.get("given_depth"),
        "frame and scale": {name: value for name, value in cell.facts["frame"].items() if name != "object_from_registration"} or None,
    }
    return [(name, json.dumps(content, indent=1, ensure_ascii=False)) for name, content in records.items() if content]
