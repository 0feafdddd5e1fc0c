"""Cameras by Depth Anything 3 (Lin et al. 2025): a network that sees all images at once; SIFT's matches refine its cameras.

The weights (137 MB of size small, 542 MB of size base) are under the Apache License 2.0, and a processor is enough. Where too little
matches, or with --refine none, the network's own cameras and depth are taken as they are, which is less exact. What is found is checked
like any registration.
"""

import argparse
from typing import Any

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.colmap import add_own_arguments
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.registration import add_common_arguments, add_estimation_arguments, add_network_arguments
from zeroshop_steps.register.vggt import add_precision_argument
from zeroshop_steps.runtime.cache import Cached

CACHED = Cached(inputs=("capture/images", "capture/masks", "weights"), ignored=("threads",))

METHOD: dict[str, Any] = {"title": "DA3 small", "rank": 3, "weights": ("DA3-SMALL/model.safetensors",), "mem_mb": 4000, "runtime_min": 60}

PRESETS: dict[str, dict[str, Any]] = {
    "da3_base": {"title": "DA3 base", "weights": ("DA3-BASE/model.safetensors",), "mem_mb": 5000, "runtime_min": 120},
}
"""Size base: four times the parameters, and 2.5 times the time."""
PUBLISHED = (*METHOD["weights"], *PRESETS["da3_base"]["weights"])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    usual = Da3Options()
    add_common_arguments(parser)
    parser.add_argument(
        "--refine", choices=("matches", "none"), default=usual.refine, help="by SIFT's matches and bundle adjustment (default: %(default)s)"
    )
    add_own_arguments(parser)
    add_precision_argument(parser, usual.precision)
    add_estimation_arguments(parser, usual.colmap.structure)
    add_network_arguments(parser, WEIGHTS_FOLDER / METHOD["weights"][0])


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    from zeroshop_steps.register.da3.solve import solve

    solve(args, PUBLISHED)
