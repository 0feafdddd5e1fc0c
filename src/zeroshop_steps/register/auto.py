"""Register by SIFT (colmap); by learned features (aliked) and by outlines alone, where nothing before them was good enough.

Learned features and outlines are proposed only with masks, which check their cameras: on whole photos of plain tables they match other
sides and other things too readily. Photos without masks get them by a salient-object network, if one is named; then SIFT's cameras, too,
are checked by such masks where few points hold them. The record says what gave the cameras, and why nothing else did.
"""

import argparse
import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from zeroshop_steps.networks.aliked import EXTRACTOR, FOLDER, MATCHER, has_weights
from zeroshop_steps.networks.saliency.salient_networks import DEFAULT, NETWORKS
from zeroshop_steps.networks.saliency.salient_object import add_network_arguments, load_network
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, read_table
from zeroshop_steps.register import aliked, colmap, silhouette_sfm
from zeroshop_steps.register.camera_proposals import Fill, Proposer, propose
from zeroshop_steps.register.pipeline import add_matching_arguments
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.register.verification import predicted_masks
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.files import scratch_directory

CACHED = Cached(inputs=("capture/images", "capture/masks", "capture/cameras.json", "weights", "network"), ignored=("threads", "device"))
METHOD = {"title": "automatic", "rank": 4, "tries": ("colmap", "aliked"), "saliency": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    colmap.add_own_arguments(parser)
    aliked.add_own_arguments(parser)
    add_network_arguments(parser, None)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    image_set = read_image_set(args.capture)
    learned = aliked.read_aliked_options(args)
    network = None if image_set.masks is not None or args.network is None else load_network(args)
    find_maps = functools.cache(predicted_masks.find_object_maps)

    def check(fill: Fill, folder: Path, before: RegistrationFailed | None) -> dict[str, Any]:
        record = fill(folder, before)
        if network is None or not predicted_masks.is_sparse(record):
            return record
        return predicted_masks.check_by_predicted_masks(folder, record, network, args.max_wrong_probability)

    def register_object(by: Callable[[ImageSet, Path], dict[str, Any]], folder: Path, _: RegistrationFailed | None) -> dict[str, Any]:
        if image_set.masks is not None:
            return by(image_set, folder)
        assert network is not None  # without masks and a network, this is not asked
        maps = find_maps(network, image_set.images)
        return predicted_masks.register_by_predicted_masks(folder, image_set, network, maps, lambda masked: by(masked, folder))

    def fill(folder: Path) -> dict[str, Any]:
        with scratch_directory(folder, "colmap") as scratch:
            scene = colmap.read_colmap_options(args)
            proposers = [
                replace(proposer, fill=functools.partial(check, proposer.fill))
                for proposer in colmap.make_proposers(image_set, scene, scratch)
            ]
            there, masked = has_weights(args.weights), image_set.masks is not None or network is not None
            if there and masked:
                prepare = aliked.make_matcher(args, learned)
                by_aliked = functools.partial(aliked.register, options=learned, prepare=prepare)
                proposers.append(Proposer("aliked", functools.partial(register_object, by_aliked)))
            if masked:
                options = silhouette_sfm.SilhouetteOptions(scene.sift, scene.structure)
                by_outlines = functools.partial(silhouette_sfm.register, options=options)
                proposers.append(Proposer("outlines", functools.partial(register_object, by_outlines)))
            return propose(folder, proposers, _advise(there, masked))

    write_registration(args.out, fill)


def _advise(there: bool, has_masks: bool) -> str:
    """What would let learned features find the cameras, as the end of a reason; empty where they had all that helps."""
    advice = ""
    if not there:
        rows = [read_table()[f"{FOLDER}/{name}"] for name in (EXTRACTOR, MATCHER)]
        megabytes = sum(row.size_bytes or 0 for row in rows) / 1e6
        advice += (
            f". Learned features may find the cameras; they need their weights, which `snakemake {WEIGHTS_FOLDER / FOLDER}/"
            f"{{{EXTRACTOR},{MATCHER}}}` downloads ({megabytes:.0f} MB, {rows[0].licence})"
        )
    if not has_masks:
        advice += (
            ". Masks of the object help them, yours or by a salient-object network (segment.saliency.network), such as"
            f" {DEFAULT}, which `snakemake {NETWORKS[DEFAULT].path}` downloads"
        )
    return advice
