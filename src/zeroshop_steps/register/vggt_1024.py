"""Cameras by VGGT as the thesis calls it with quarter precision: at most 1024 tracked points from each of 20 views, one pinhole lens.

The tracks are those of VGGT's own tracking head; the thesis used the tracker of VGGSfM (Wang et al., CVPR 2024).
"""

import argparse
from dataclasses import replace

from zeroshop_steps.register import vggt
from zeroshop_steps.register.vggt.options import THESIS

CACHED = vggt.CACHED

METHOD = {
    "title": "VGGT 1024",
    "rank": 3,
    "weights": ("VGGT-1B/model.safetensors",),
    "mem_mb": 12000,
    "runtime_min": 480,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    vggt.add_arguments(parser, replace(THESIS, tracked_points=1024))


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    vggt.run(args)
