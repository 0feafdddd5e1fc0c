"""Command line of the surface stage; see `--method NAME --help`."""

import os
import sys

# Before any library starts its threads: one that waits must not spin, or the kernels' and the losses' threads fight for two cores.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from zeroshop_steps.runtime.cli import stage_main  # noqa: E402

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.surface"))
