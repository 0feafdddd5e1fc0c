"""Mask the object with the help of a salient-object network, which has learned what things look like, whatever they stand on.

The network sees one photo at a time: it takes other things along, and now and then a part for the whole. So all photos vote in
space first, and what the network says counts where they agree. On the ground the geometry then decides as in support_plane, with the
network as a prior. Where there is no ground, what the photos agree on is the object.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.networks.object_finder import cut_main_things
from zeroshop_steps.networks.saliency_maps import FINE_WIDTH_PX, find_maps
from zeroshop_steps.networks.salient_networks import DEFAULT
from zeroshop_steps.networks.salient_object import add_network_arguments, load_network
from zeroshop_steps.segment import support_plane
from zeroshop_steps.segment.mask_agreement import assess_masks
from zeroshop_steps.segment.mask_quality import check_enough_good, describe_quality
from zeroshop_steps.segment.prior_maps import Masks, find_by_maps
from zeroshop_steps.segment.record import add_common_arguments, show_rejected_masks, write_segmented

METHOD: dict[str, Any] = {"rank": 1, "saliency": True, "runtime_min": 60}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    add_mask_arguments(parser)


def add_mask_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the network, whether or not the cameras are known."""
    add_network_arguments(parser, DEFAULT)
    parser.add_argument(
        "--image-width-px", type=int, default=support_plane.WIDTH_PX, help="images are cut at this width (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    start_s = time.monotonic()
    views, model = read_views(args.scene)
    maps = find_maps(args.scene, load_network(args), [view.image_path for view in views], args.image_width_px)

    def find_on_ground(prior: list[np.ndarray]) -> Masks:
        return support_plane.find_masks(views, model, args.image_width_px, args.seed, prior)

    with show_rejected_masks([view.image_path for view in views], args.rejected):
        masks, record = find_by_maps(maps, views, find_on_ground)
    record |= {"method": "saliency", "network": args.network.name, "seconds": round(time.monotonic() - start_s, 2)}
    write_segmented(args.scene, args.out, views, masks, set(record["dropped"]), record)


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
