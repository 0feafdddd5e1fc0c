"""Command line of the finish stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("clean", "underside", "frame", "unwrap", "texture", "evidence", "outcome", "export", "quality", "grade", "preview", "publish")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.finish", METHODS))
