"""Record that the licences of some files of weights, which the workflow has shown, were agreed to: one a line."""

import argparse
from pathlib import Path

from zeroshop_steps.networks.weights import look_up_weights
from zeroshop_steps.runtime.files import atomic_write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--files", nargs="+", required=True, help="their paths below resources/weights, as in weights.csv")
    parser.add_argument("--out", type=Path, required=True, help="text file to write")


def run(args: argparse.Namespace) -> None:
    """Write the file."""
    licences = sorted({look_up_weights(file).licence for file in args.files})
    with atomic_write(args.out) as temporary:
        temporary.write_text("".join(f"{licence}\n" for licence in licences))
