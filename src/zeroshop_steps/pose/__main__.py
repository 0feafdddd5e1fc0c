"""Command line of the pose stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("render_compare",)

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.pose", METHODS))
