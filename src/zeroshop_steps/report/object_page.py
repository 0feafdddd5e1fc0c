"""The page of one object: its meshes in 3D and every stage from input to mesh. It needs a browser, but no server and no internet.

The page shows what exists so far and marks what is missing.
"""

import argparse
import shlex
from pathlib import Path

from zeroshop_steps.methods import REGISTRATIONS, SURFACES
from zeroshop_steps.report.site.advice import advise
from zeroshop_steps.report.site.html import write_page
from zeroshop_steps.report.site.results_index import Cell, Run, find_runs
from zeroshop_steps.report.site.sections import make_run_sections
from zeroshop_steps.report.site.thumbnails import render_thumbnail, write_webp
from zeroshop_steps.report.site.viewer_meshes import TrueModel, read_true_model, write_meshes
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--object", type=Path, required=True, help="the object's folder, e.g. results/demo/mug; it may be missing")
    chosen = f"su_h/{next(iter(REGISTRATIONS))}"
    parser.add_argument("--chosen", default=chosen, help="scene/registration that is shown first (default: %(default)s)")
    parser.add_argument("--faces", type=int, default=20000, help="triangles at most of a mesh in the viewer (default: %(default)s)")
    parser.add_argument("--texture-px", type=int, default=1024, help="side at most of a texture in the viewer (default: %(default)s)")
    parser.add_argument(
        "--config", nargs="+", default=[], help="what was changed of the config for these cells, as Snakemake's --config takes it"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")


def run(args: argparse.Namespace) -> None:
    """Write the page, its data and pictures, and card.json, which the gallery reads."""
    if args.faces < 100 or args.texture_px < 16:
        raise StepError(f"--faces is {args.faces}, --texture-px {args.texture_px}; at least 100 triangles and 16 pixels are needed")
    runs = sort_chosen_first(find_runs(args.object), args.chosen)
    truth = read_true_model(args.object / "model", args.faces, args.texture_px)
    info = read_model_info(args.object)
    with atomic_directory(args.out) as folder:
        manifest = write_meshes(runs, truth, folder, args.faces, args.texture_px)
        card = {
            "dataset": args.object.absolute().parent.name,
            "object": args.object.name,
            "name": choose_name(args.object, info),
            "number": info.get("obj_id"),
            "viewer": bool(manifest["runs"] or truth),
            "thumbnail": write_thumbnail(runs, truth, folder),
            "cells": [make_cell_card(cell, f"{run.scene}/{run.registration}" == args.chosen) for run in runs for cell in run.cells],
        }
        write_json(folder / "card.json", card)
        command, changes = f"snakemake --cores 2 {args.object}/{next(iter(SURFACES))}.ply", format_changes(args.config)
        sections = make_run_sections(runs, folder, changes)
        write_page(folder / "index.html", "object.html", card=card, sections=sections, command=command + changes, root="../../")


def format_changes(changes: list[str]) -> str:
    """Changes of the config as the end of a command line."""
    return f" --config {' '.join(map(shlex.quote, changes))}" if changes else ""


def read_model_info(folder: Path) -> dict:
    """The model_info.json of an object; empty if there is none or it is damaged."""
    info = folder / "model/model_info.json"
    try:
        return read_json(info) if info.is_file() else {}
    except StepError as error:
        warn(str(error))
        return {}


def choose_name(folder: Path, info: dict) -> str:
    """The displayed name of an object: that of its model, if it differs from the folder's."""
    name = str(info.get("name") or "")
    return f"{name} ({folder.name})" if name and name != folder.name else folder.name


def sort_chosen_first(runs: list[Run], chosen: str) -> list[Run]:
    """The runs, the one that the config chooses first."""
    return sorted(runs, key=lambda run: f"{run.scene}/{run.registration}" != chosen)


def make_cell_card(cell: Cell, chosen: bool) -> dict:
    """What the gallery and the tables show of a cell."""
    return {
        "key": cell.key,
        "chosen": chosen,
        "scene": cell.scene,
        "registration": cell.registration,
        "nvs": cell.nvs,
        "state": cell.state,
        "grade": cell.grade,
        "reasons": list(cell.reasons),
        "advice": " ".join(advise(cell)),
        "steps": [[name, done] for name, done in cell.steps],
        "steps_done": cell.steps_done,
        "figures": cell.figures,
    }


def write_thumbnail(runs: list[Run], truth: TrueModel | None, folder: Path) -> str | None:
    """Write a picture of the first finished mesh, otherwise of the true model. Returns its name, or None if there is neither."""
    picture = render_thumbnail(runs, truth)
    if picture is None:
        return None
    write_webp(folder / "thumbnail.webp", picture)
    return "thumbnail.webp"
