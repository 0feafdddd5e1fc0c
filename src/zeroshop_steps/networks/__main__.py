"""Command line of the networks: fetching weights; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("fetch_weights",)

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.networks", METHODS))
