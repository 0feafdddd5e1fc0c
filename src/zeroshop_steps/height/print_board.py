"""Write the board that `--method marker` looks for, as a PDF to print at exact size."""

import argparse
import sys
from pathlib import Path

from zeroshop_steps.geometry.boards.board_files import BOARDS
from zeroshop_steps.geometry.boards.printed_board import RULER_MM, write_pdf
from zeroshop_steps.runtime.errors import StepError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--board", type=str.lower, choices=sorted(BOARDS), default="a4", help="size of the paper (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="PDF to write")


def run(args: argparse.Namespace) -> None:
    """Write the PDF."""
    if args.out.suffix.lower() != ".pdf":
        raise StepError(f"{args.out} is no PDF; give a name that ends in .pdf")
    board = BOARDS[args.board]
    write_pdf(board, args.out)
    print(f"{args.out}: print it at 100 %; squares are {board.square_mm:g} mm, the line below them {RULER_MM:g} mm", file=sys.stderr)
