"""Command line of the BOP stage; see `--method NAME --help`."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("align", "export_models", "test_set", "train_set", "score_poses", "score_detections", "pictures")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.bop", METHODS, reads_failures=("export_models",)))
