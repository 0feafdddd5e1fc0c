"""Cameras by VGGT (Wang et al. 2025): a network that sees all images at once, its tracks refined by bundle adjustment.

The weights, 5 GB under the licence CC BY-NC 4.0, must be there. With --refine none the network's own cameras and depth
are taken as they are, which is faster and less exact. What is found is checked like any registration.
"""

import argparse
from typing import Any

from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.registration import add_common_arguments, add_estimation_arguments, add_network_arguments, add_options
from zeroshop_steps.register.vggt.options import VggtOptions
from zeroshop_steps.runtime.cache import Cached

CACHED = Cached(inputs=("capture/images", "capture/masks", "weights"), ignored=("threads",))

METHOD: dict[str, Any] = {"title": "VGGT", "rank": 3, "weights": ("VGGT-1B/model.safetensors",), "mem_mb": 12000, "runtime_min": 240}
PRESETS: dict[str, dict[str, Any]] = {
    "vggt_1024": {
        "title": "VGGT 1024",
        "runtime_min": 480,
        "defaults": {"query_views": 30, "lens": "simple_pinhole", "max_error_px": 8.0},
    },
    "vggt_4096": {
        "title": "VGGT 4096",
        "mem_mb": 24000,
        "runtime_min": 480,
        "defaults": {"tracked_points": 4096, "query_views": 30, "lens": "simple_pinhole", "max_error_px": 8.0},
    },
    "vggt_commercial": {"title": "VGGT (commercial)", "weights": ("VGGT-1B-Commercial/vggt_1B_commercial.pt",)},
}
"""As the thesis calls it with quarter and full precision (it took the tracks of VGGSfM), and the same network trained again, whose licence
allows commercial use: Meta gives it to those who accept it, so its file is put into place by hand."""
PUBLISHED = (*METHOD["weights"], *PRESETS["vggt_commercial"]["weights"])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    defaults = VggtOptions()
    add_common_arguments(parser)
    parser.add_argument(
        "--refine", choices=("tracks", "none"), default=defaults.refine, help="by tracks and bundle adjustment (default: %(default)s)"
    )
    views = "views whose points are followed, a pass each"
    add_options(parser, defaults, tracked_points="points to follow a query view", query_views=views)
    lens_help = "camera model of the one lens for all (default: %(default)s)"
    parser.add_argument("--lens", choices=("simple_radial", "simple_pinhole"), default=defaults.lens.lower(), help=lens_help)
    add_options(parser, defaults, max_error_px="largest error of a track that counts in the end, per 1000 px of width")
    add_precision_argument(parser, defaults.precision)
    add_estimation_arguments(parser, defaults.structure)
    add_network_arguments(parser, WEIGHTS_FOLDER / METHOD["weights"][0])


def add_precision_argument(parser: argparse.ArgumentParser, usual: str) -> None:
    """The precision of a large network."""
    text = "of the attention; auto is bfloat16 where a CUDA device has it (default: %(default)s)"
    parser.add_argument("--precision", choices=("auto", "float32", "bfloat16"), default=usual, help=text)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    from zeroshop_steps.register.vggt.solve import solve

    solve(args, PUBLISHED)
