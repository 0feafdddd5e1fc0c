"""Command line of the registration stage."""

import sys

from zeroshop_steps.cli import stage_main

METHODS = ("colmap", "mast3r", "vggt", "truth", "camera_error")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.register", METHODS))
