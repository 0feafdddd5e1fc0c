"""Record how a cell of a table ended: with a mesh, or which step failed and why (see zeroshop_steps.runtime.failures)."""

import argparse
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--parts", type=Path, nargs="+", required=True, help="the files that the finished mesh consists of")
    parser.add_argument("--without-cameras", action="store_true", help="the parts are a raw mesh that was made without cameras")
    parser.add_argument("--out", type=Path, required=True, help="JSON to write")


def run(args: argparse.Namespace) -> None:
    """Write that nothing failed. If one of the parts records a failure, the command line has copied it and does not get here.

    Raises:
        StepError: the mesh was made without cameras.
    """
    if args.without_cameras:
        raise StepError("the raw mesh was made without cameras; height and grade need them, so nothing is measured")
    write_json(args.out, {"failed": None})
