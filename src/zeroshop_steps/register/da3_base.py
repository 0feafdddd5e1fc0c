"""Cameras by Depth Anything 3, size base: four times the parameters of `da3`, and 2.5 times its time. A run is that of `da3`."""

import argparse
from typing import Any

from zeroshop_steps.networks.da3.settings import BASE
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register import da3

CACHED = da3.CACHED

METHOD: dict[str, Any] = {"title": "DA3 base", "rank": 3, "weights": ("DA3-BASE/model.safetensors",), "mem_mb": 5000, "runtime_min": 120}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    da3.add_arguments(parser)
    parser.set_defaults(weights=WEIGHTS_FOLDER / METHOD["weights"][0])


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    da3.run(args, METHOD["weights"][0], BASE)
