"""Say how a cell of a table ended: that it became a mesh, or which step failed and why (zeroshop_steps.runtime.failures)."""

import argparse
from pathlib import Path

from zeroshop_steps.runtime.files import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--parts", type=Path, nargs="+", required=True, help="what the finished mesh is put together from")
    parser.add_argument("--out", type=Path, required=True, help="JSON to write")


def run(args: argparse.Namespace) -> None:
    """Write that nothing failed; a record among the parts has been passed on before this."""
    write_json(args.out, {"failed": None})
