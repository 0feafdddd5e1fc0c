"""Command line of the scan stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.runtime.cli import stage_main

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.scan"))
