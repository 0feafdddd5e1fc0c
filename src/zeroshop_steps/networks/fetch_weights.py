"""Download a file of weights from its publisher, under the publisher's licence, and check its size and SHA-256."""

import argparse
import sys
from pathlib import Path

from zeroshop_steps.networks.weights import fetch_weights, look_up_weights


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--file", required=True, help="its path below resources/weights, as in weights.csv")
    parser.add_argument("--out", type=Path, required=True, help="file to write")


def run(args: argparse.Namespace) -> None:
    """Write the file."""
    row = look_up_weights(args.file)
    print(f"{row.file}: for {row.purpose}, from {row.source}. Its licence: {row.licence}. By using it you accept that.", file=sys.stderr)
    fetch_weights(args.file, args.out)
