"""What came out of a run, in a few lines for people: the mesh, its size and grade, and what to photograph again."""

import itertools
import re
from pathlib import Path
from typing import Any

from zeroshop_steps.app.run_lock import LOCKS, describe_holder
from zeroshop_steps.report.site.advice import advise
from zeroshop_steps.report.site.results_index import read_cell
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.run_warnings import warnings_since

WORTH_SHARE = 0.04
"""From this share of the surface that no photo shows on, a second pass is worth it: undersides of boxes and cans have 0.1 to 0.3."""
SHOWN = 8
"""Reasons and warnings at most; all are in the JSON and the logs."""


def describe_mesh(mesh: Path) -> list[str]:
    """Lines about a finished mesh with its JSON beside it."""
    facts = read_json(mesh.with_suffix(".json"))
    lines = [
        f"Mesh      {mesh}",
        f"          {mesh.with_suffix('.glb').name} for viewers, {mesh.with_suffix('.preview.png').name} to look at",
    ]
    sizes = facts.get("extents") or []
    if facts.get("scale") == "known":
        width, depth, height = sizes
        lines.append(f"Size      {width:.1f} x {depth:.1f} x {height:.1f} mm (the last one is its height; scale: {facts['scale_source']})")
    else:
        lines.append("Size      unknown: give the object's height in metres with --height, or show a printed board")
    grade: dict[str, Any] = facts.get("grade") or {}
    lines.append(f"Grade     {grade.get('grade', 'unknown')}")
    lines += [f"          {reason}" for reason in grade.get("reasons", [])[:SHOWN]]
    return lines


def describe_unseen(mesh: Path) -> list[str]:
    """Lines on what no photo shows of a finished mesh, and whether a second pass is worth it."""
    unseen = (read_json(mesh.with_suffix(".json")).get("area_shares") or {}).get("unseen", 0.0)
    if unseen < WORTH_SHARE:
        return []
    return [
        f"Unseen    {unseen:.0%} of the surface is in no photo, most of it below. For a mesh of all sides, turn the object over,",
        "          film it again, and give both: zeroshop FIRST SECOND",
    ]


def describe_advice(cell: Path, cameras: Path) -> list[str]:
    """Lines on what to photograph again; none where nothing is wrong.

    Args:
        cell: the folder of the cell.
        cameras: the folder of its registered cameras.
    """
    record = read_json(cameras / "registration.json") if (cameras / "registration.json").is_file() else {}
    advice = [*advise(read_cell(cell)), *(record.get("advice") or [])]
    return [f"Next      {line}" if index == 0 else f"          {line}" for index, line in enumerate(dict.fromkeys(advice))]


def describe_warnings(folder: Path, start_s: float) -> list[str]:
    """Lines on what the steps warned of since `start_s`, in seconds since the epoch."""
    found = [line.partition(".log: ")[2] or line for line in warnings_since(folder, start_s)]
    lines = [f"Note      {line}" for line in found[:SHOWN]]
    return lines + ([f"          and {len(found) - SHOWN} more in the logs below {folder}"] if len(found) > SHOWN else [])


def name_photos(line: str, folder: Path) -> str:
    """A line with the names of the user's photos in place of those of their copies; frames of a film keep theirs.

    Args:
        line: what a step said.
        folder: the results of the object.
    """
    record = folder / "video/capture/capture.json"
    names = read_json(record).get("source_names", []) if record.is_file() else []

    def name(copy: re.Match[str]) -> str:
        index = int(copy[1])
        return str(names[index]) if index < len(names) else copy[0]

    return re.sub(r"\b(\d{6})\.png\b", name, line)


def find_reason(log: Path) -> list[str]:
    """The errors that the steps of a failed run ended with, from Snakemake's report; its last lines where none is marked."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in log.read_text(errors="replace").splitlines()]
    errors = [line.partition("rror: ")[2] for line in lines if line.startswith(("error: ", "StepError: "))]
    if errors:
        return list(dict.fromkeys(errors))
    if any("LockException" in line or "cannot be locked" in line for line in lines):
        named = [after for line, after in itertools.pairwise(lines) if line.endswith("following directory:")]
        folder = Path(named[0]) if named else Path()
        return [f"another run works in {folder.resolve()}{describe_holder(folder)}; wait for it, or, if none does, delete {folder / LOCKS}"]
    marked = [index for index, line in enumerate(lines) if "Error" in line or "Exception" in line]
    return [line for line in lines[(marked[0] if marked else -5) :] if line][:5]
