"""Gather the tidy CSVs of many cells into one, with the coordinates of each cell as columns.

The coordinates are read from the paths, which name the matrix: results/DATASET/OBJECT/SCENE/REGISTRATION[/NVS]/FILE. A
cell that failed comes as the record of its failure; it becomes one row with grade `none` and the reason.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import atomic_write

AXES = ("dataset", "object", "scene", "registration", "nvs")

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--measurements", type=Path, nargs="+", required=True, help="a CSV of each cell, or the record of its failure")
    parser.add_argument("--root", type=Path, default=Path("results"), help="folder that the cells' paths start with (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table."""
    write_table(gather(args.measurements, args.root), args.out)


def gather(measurements: Sequence[Path], root: Path) -> list[dict[str, str]]:
    """The rows of all cells, each with its coordinates, in the order of the files.

    Raises:
        StepError: a file that is missing, empty, or not below `root`.
    """
    rows: list[dict[str, str]] = []
    for path in measurements:
        where = parse_cell(path, root)
        failure = read_failure(path)
        if failure:
            row = {**where, "measure": "grade", "value": "none", "reason": str(failure)}
            # A step that was given the record has left the same one.
            rows.extend([row] if row not in rows[-1:] else [])
            continue
        rows.extend({**row, **where} for row in read_rows(path))
    return rows


def read_rows(path: Path) -> list[dict[str, str]]:
    """The measurements in a CSV. Raises StepError where it is missing or has none."""
    try:
        with path.open(newline="") as file:
            measured = list(csv.DictReader(file))
    except FileNotFoundError:
        raise StepError(f"{path} does not exist; run the step that writes it first") from None
    if not measured:
        raise StepError(f"{path} has no rows; delete it and run its step again")
    return measured


def parse_cell(path: Path, root: Path) -> dict[str, str]:
    """The matrix coordinates in a path below `root`; a registration's own files have no nvs."""
    try:
        folders = path.relative_to(root).parent.parts
    except ValueError:
        raise StepError(f"{path} is not below {root}; give the folder that the cells' paths start with as --root") from None
    if not len(AXES) - 1 <= len(folders) <= len(AXES):
        raise StepError(f"{path} does not lie in a cell; expected {root}/DATASET/OBJECT/SCENE/REGISTRATION[/NVS]/FILE")
    return dict(zip(AXES, folders, strict=False))


def write_table(rows: Sequence[dict[str, str]], out: Path) -> None:
    """Write rows as CSV: the coordinates first, then every column that any row has; what a row lacks stays empty."""
    columns = dict.fromkeys([*(axis for axis in AXES if any(axis in row for row in rows)), *(key for row in rows for key in row)])
    with atomic_write(out) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(columns), restval="")
        writer.writeheader()
        writer.writerows(rows)
