"""Gather the tidy CSVs of many cells into one, with the coordinates of each cell as columns.

The coordinates are read from the paths: results/DATASET/OBJECT/SCENE/REGISTRATION[/NVS]/FILE. For a failed cell, the record of its
failure is given instead of its CSV; it becomes one row with grade `none` and the reason.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.tables import read_table, write_table

AXES = ("dataset", "object", "scene", "registration", "nvs")

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--measurements", type=Path, nargs="+", required=True, help="a CSV of each cell, or the record of its failure")
    parser.add_argument("--root", type=Path, default=Path("results"), help="folder that the cells' paths start with (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table."""
    write_table(args.out, gather(args.measurements, args.root))


def gather(measurements: Sequence[Path], root: Path) -> pd.DataFrame:
    """The rows of all cells in the order of the files: the coordinates first, then all columns of any file.

    Raises:
        StepError: a file that is missing, empty, or not below `root`.
    """
    parts: list[pd.DataFrame] = []
    for path in measurements:
        where = parse_cell(path, root)
        failure = read_failure(path)
        if failure is None:
            parts.append(read_table(path).assign(**where))
            continue
        row = pd.DataFrame([{**where, "measure": "grade", "value": "none", "reason": str(failure)}])
        # A step that was given the record has left the same one.
        if not (parts and parts[-1].equals(row)):
            parts.append(row)
    table = pd.concat(parts, ignore_index=True)
    axes = [axis for axis in AXES if axis in table]
    return table[[*axes, *table.columns.drop(axes)]]


def parse_cell(path: Path, root: Path) -> dict[str, str]:
    """The coordinates of a cell from a path below `root`; files of a registration have no nvs."""
    try:
        folders = path.relative_to(root).parent.parts
    except ValueError:
        raise StepError(f"{path} is not below {root}; give the folder that the cells' paths start with as --root") from None
    if not len(AXES) - 1 <= len(folders) <= len(AXES):
        raise StepError(f"{path} does not lie in a cell; expected {root}/DATASET/OBJECT/SCENE/REGISTRATION[/NVS]/FILE")
    return dict(zip(AXES, folders, strict=False))
