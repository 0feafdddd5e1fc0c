"""Command line of the report stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("table", "reconstruction", "heights", "film_heights", "bop", "object_page", "gallery")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.report", METHODS, reads_failures=METHODS))
