"""Record that a cell without cameras ended with its raw mesh, as failures are recorded (zeroshop_steps.runtime.failures)."""

import argparse
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="the raw mesh, or the record of its failure")
    parser.add_argument("--out", type=Path, required=True, help="where it is recorded, with --record-failure")


def run(args: argparse.Namespace) -> None:
    """Say so. If the mesh records a failure, the command line has copied that and does not get here.

    Raises:
        StepError: always.
    """
    raise StepError("the raw mesh was made without cameras; height and grade need them, so nothing is measured")
