"""Command line of the detect stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("templates", "contour", "cnos", "filter_masks")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.detect", METHODS))
