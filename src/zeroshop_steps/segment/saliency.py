"""Mask the object with the help of two networks that have learned what things look like, whatever they stand on.

A salient-object network finds it, and Segment Anything cuts it out where the other photos show it. They see one photo at a time: they take
other things along, and now and then a part for the whole. So they are cues among those of support_plane, and all photos decide together.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.networks.mobile_sam import choice
from zeroshop_steps.networks.mobile_sam.model import MobileSam
from zeroshop_steps.networks.saliency.object_finder import cut_main_things
from zeroshop_steps.networks.saliency.saliency_maps import FINE_WIDTH_PX
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT
from zeroshop_steps.networks.saliency.salient_object import add_network_arguments, load_network
from zeroshop_steps.segment import support_plane
from zeroshop_steps.segment.finder import WIDTH_PX
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.quality.mask_agreement import assess_masks
from zeroshop_steps.segment.quality.mask_quality import check_enough_good, describe_quality
from zeroshop_steps.segment.record import add_common_arguments

METHOD: dict[str, Any] = {"rank": 1, "saliency": True, "runtime_min": 60}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    support_plane.add_choice_arguments(parser)
    add_mask_arguments(parser)


def add_mask_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the network, whether or not the cameras are known."""
    add_network_arguments(parser, DEFAULT)
    parser.add_argument("--segmenter", default=choice.DEFAULT, help=(
        f"weights of Segment Anything, for registered photos: {choice.DEFAULT}, a file, or {choice.NONE}"))  # fmt: skip
    parser.add_argument("--image-width-px", type=int, default=WIDTH_PX, help="images are cut at this width (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    weights = choice.find_segmenter(args.segmenter)
    segmenter = None if weights is None else PromptedSegmenter(MobileSam(weights))
    support_plane.write_found_masks(args, "saliency", load_network(args), segmenter)


def mask_photos(paths: list[Path], sizes_px: list[tuple[int, int]], args: argparse.Namespace) -> tuple[list[np.ndarray], dict[str, Any]]:
    """(H, W) bool masks of photos whose cameras are not known, and the record of their quality.

    Args:
        paths: the photos.
        sizes_px: (width, height) of each.
        args: those of `add_mask_arguments`.

    Raises:
        StepError: the network is missing or damaged, or too few masks are good.
    """
    network = load_network(args)
    masks = cut_main_things(network.look_closer(paths, network.find_maps(paths, args.image_width_px), FINE_WIDTH_PX), sizes_px)
    _, qualities = assess_masks(masks, None)
    names = [path.name for path in paths]
    check_enough_good(qualities, names, masks)
    return masks, {"method": "saliency", "network": network.name, **describe_quality(qualities, names)}
