"""Mask the object that stands where the cameras look, by the ground and its own colours. No weights are needed."""

import argparse
import time
from pathlib import Path

from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.networks.saliency.saliency_maps import find_maps
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.segment.finder import WIDTH_PX, find_masks
from zeroshop_steps.segment.list_objects import read_center
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.photometry.exposure import estimate_exposure
from zeroshop_steps.segment.record import add_common_arguments, show_rejected_masks, write_segmented

METHOD = {"rank": 2, "in_scene": True, "runtime_min": 60}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    add_choice_arguments(parser)
    parser.add_argument("--image-width-px", type=int, default=WIDTH_PX, help="images are cut at this width (default: %(default)s)")


def add_choice_arguments(parser: argparse.ArgumentParser) -> None:
    """Which of several objects is meant."""
    parser.add_argument("--objects", type=Path, help="objects.json of the scene; without it, the likeliest object is meant")
    parser.add_argument("--number", type=int, default=1, help="of the object in it (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    write_found_masks(args, "support_plane")


def write_found_masks(
    args: argparse.Namespace, method: str, network: SalientObjectNetwork | None = None, segmenter: PromptedSegmenter | None = None
) -> None:
    """Find the masks of a registered scene, and write its cameras folder."""
    start_s = time.monotonic()
    views, model = read_views(args.scene)
    images = [view.image_path for view in views]
    saliency = None if network is None else find_maps(args.scene, network, images, args.image_width_px)
    exposure = estimate_exposure(args.scene, views)
    with show_rejected_masks(images, args.rejected):
        place = None if args.objects is None else read_center(args.objects, args.number)
        masks, record = find_masks(views, model, exposure, saliency, network, args.image_width_px, args.seed, place, segmenter)
    record |= {"method": method, "seconds": round(time.monotonic() - start_s, 2)}
    if network is not None:
        record |= {"network": network.name, "segmenter": None if segmenter is None else segmenter.name}
    write_segmented(args.scene, args.out, views, masks, set(record["dropped"]), record, exposure)
