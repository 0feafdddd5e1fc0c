"""The table of heights measured in rendered films beside the true ones: one row per film, with the reason if there is no height."""

import argparse
from pathlib import Path

from zeroshop_steps.report.table import parse_cell
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.tables import write_table

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--heights", type=Path, nargs="+", required=True, help="height.json of each film, or the record of its failure")
    parser.add_argument("--truths", type=Path, nargs="+", required=True, help="the truth folder of each, in the same order")
    parser.add_argument("--root", type=Path, default=Path("results"), help="folder that the cells' paths start with (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table."""
    write_table(args.out, [make_row(*pair, args.root) for pair in zip(args.heights, args.truths, strict=True)])


def make_row(height: Path, truth: Path, root: Path) -> dict[str, str]:
    """The coordinates of a film's cell, its true and its measured height, and their difference."""
    true_m = read_json(truth / "truth.json")["height_m"]
    row = {**parse_cell(height, root), "height_m": f"{true_m:.6f}"}
    failure = read_failure(height)
    if failure:
        return row | {"reason": str(failure)}
    record = read_json(height)
    measured_m = record["height_m"]
    if measured_m is None:
        return row | {"reason": "the scale is unknown"}
    evidence = record["evidence"]
    return row | {
        "measured_height_m": f"{measured_m:.6f}",
        "deviation_mm": f"{1000 * record['height_deviation_m']:.3f}",
        "difference_mm": f"{1000 * (measured_m - true_m):.3f}",
        "difference_percent": f"{100 * (measured_m / true_m - 1):.3f}",
        "board_seen_in": str(evidence.get("board_seen_in", "")),
        "corners": str(evidence.get("corners", "")),
        "reason": "",
    }
