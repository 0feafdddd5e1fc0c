"""The costs and the origin of a cell: seconds and memory of its steps, measures of its grade, parameters and versions."""

import json
from pathlib import Path

import pandas as pd

from zeroshop_steps.evaluate.grading import MEASURES
from zeroshop_steps.report.site.results_index import Cell, Run, find_table, read_facts

# Curves that a page shows of a training, in this order, as far as the method has them.
CURVES = ("loss", "l1", "mask", "depth", "normal")
ORDER = (
    *("capture", "segment", "register", "camera_error", "stereo", "train", "fuse", "mesh", "shape", "texture", "outcome", "evaluate"),
    "cell",
)
"""The steps of a cell in their order."""


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
