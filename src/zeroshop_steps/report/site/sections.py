"""The sections of an object's page: pictures and cameras of each run, and every stage of each of its cells."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.report.site.advice import advise, advise_on_failure
from zeroshop_steps.report.site.plan import camera_plan
from zeroshop_steps.report.site.provenance import list_costs, list_measures, list_provenance, read_training_curves
from zeroshop_steps.report.site.results_index import Cell, Run, find_table
from zeroshop_steps.report.site.svg_plots import line_chart
from zeroshop_steps.report.site.viewer_meshes import read_object_frame
from zeroshop_steps.report.site.views import write_sheets, write_views
from zeroshop_steps.runtime.errors import StepError, warn


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
    centred = np.eye(4)
    centred[:3, 3] = -np.mean([camera.centre_in_world for camera in model.cameras], axis=0)
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
