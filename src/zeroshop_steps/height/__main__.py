"""Command line of the height stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("known", "marker", "depth_camera", "mast3r", "none", "print_board")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.height", METHODS))
