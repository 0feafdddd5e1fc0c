"""Cameras by Depth Anything 3, size small (Lin et al. 2025): a network that sees all images at once; SIFT's matches refine its cameras.

The weights, 137 MB, are under the Apache License 2.0, and a processor is enough. Where too little matches, or with --refine none, the
network's own cameras and depth are taken as they are, which is less exact. What is found is checked like any registration.
"""

import argparse
from pathlib import Path
from typing import Any

from zeroshop_steps.networks.da3.settings import SMALL, Da3Settings
from zeroshop_steps.networks.devices import DEVICES
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.registration import add_common_arguments, add_estimation_arguments
from zeroshop_steps.runtime.cache import Cached

CACHED = Cached(inputs=("capture/images", "capture/masks", "weights"), ignored=("threads",))

METHOD: dict[str, Any] = {"title": "DA3 small", "rank": 3, "weights": ("DA3-SMALL/model.safetensors",), "mem_mb": 4000, "runtime_min": 60}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    usual = Da3Options()
    add_common_arguments(parser)
    parser.add_argument(
        "--refine", choices=("matches", "none"), default=usual.refine, help="by SIFT's matches and bundle adjustment (default: %(default)s)"
    )
    features = usual.colmap.sift.max_features
    parser.add_argument("--max-features", type=int, default=features, help="SIFT features per image (default: %(default)s)")
    parser.add_argument(
        "--precision",
        choices=("auto", "float32", "bfloat16"),
        default=usual.precision,
        help="of the attention; auto is bfloat16 where a CUDA device has it (default: %(default)s)",
    )
    structure = usual.colmap.structure
    add_estimation_arguments(parser, structure.min_share, structure.min_images, structure.seed)
    parser.add_argument("--device", choices=DEVICES, default="auto", help="default: %(default)s")
    default = WEIGHTS_FOLDER / METHOD["weights"][0]
    parser.add_argument("--weights", type=Path, default=default, help="the network's weights (default: %(default)s)")


def run(args: argparse.Namespace, published: str = METHOD["weights"][0], settings: Da3Settings = SMALL) -> None:
    """Write the cameras folder; `published` is the checkpoint, below resources/weights, of the network of size `settings`."""
    from zeroshop_steps.register.da3.solve import solve

    solve(args, published, settings)
