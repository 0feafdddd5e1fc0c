import os
import sys

# Before any library starts its threads: one that waits must not spin, or the kernels' and the losses' threads fight for two cores.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from zeroshop_steps.cli import stage_main  # noqa: E402

METHODS = ("stereo", "twodgs", "fuse", "svraster", "svraster_mesh")

if __name__ == "__main__":
    sys.exit(stage_main("zeroshop_steps.nvs", METHODS))
