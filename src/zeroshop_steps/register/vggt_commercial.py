"""Cameras by VGGT with the checkpoint whose licence allows commercial use, VGGT-1B-Commercial: the same network, trained again.

Meta gives it to those who ask for it and accept its licence, so its file is put into place by hand. A run is that of `vggt`.
"""

import argparse
from typing import Any

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register import vggt

CACHED = vggt.CACHED

METHOD: dict[str, Any] = {
    "title": "VGGT (commercial)",
    "rank": 3,
    "weights": ("VGGT-1B-Commercial/vggt_1B_commercial.pt",),
    "mem_mb": 12000,
    "runtime_min": 240,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    vggt.add_arguments(parser)
    parser.set_defaults(weights=WEIGHTS_FOLDER / METHOD["weights"][0])


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    vggt.run(args, METHOD["weights"][0])
