"""What robots make of several things on a table, clear of one another and overlapping (4.4.3), beside the thesis's figures.

Shares of objects that were segmented, and of these, with a right pose: the rows that `grasp.csv` has, too, without grasping anything.
"""

import argparse
from pathlib import Path

from zeroshop_steps.report.grasping import SCENES, THESIS, sum_scenes
from zeroshop_steps.report.published.thesis_entries import GRASPS
from zeroshop_steps.runtime.tables import read_table, write_table

COLUMNS = ("dataset", "models", "measure", "value", "source")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--scenes", type=Path, nargs="+", required=True, help="folders DATASET/bop/sightings/MODELS")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write")


def run(args: argparse.Namespace) -> None:
    """Write the table."""
    measures = [name for names in SCENES.values() for name in names]
    published = [row | {"source": THESIS} for row in read_table(GRASPS).to_dict("records") if row["measure"] in measures]
    write_table(args.out, [row for folder in args.scenes for row in sum_scenes(folder)] + published, COLUMNS)
