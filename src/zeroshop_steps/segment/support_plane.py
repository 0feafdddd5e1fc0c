"""Mask the object that stands where the cameras look, by the ground and its own colours. No weights are needed."""

import argparse
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.networks.saliency.saliency_maps import find_maps
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_MISSED_PX, measure_silhouette_misses_px
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import scratch_directory
from zeroshop_steps.segment.finder import WIDTH_PX, find_masks
from zeroshop_steps.segment.list_objects import read_center
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.photometry.exposure import estimate_exposure
from zeroshop_steps.segment.record import add_common_arguments, show_rejected_masks, write_segmented
from zeroshop_steps.segment.straightened_scene import straighten_scene

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


@dataclass(frozen=True)
class FoundMasks:
    """Masks of a scene.

    Attributes:
        scene, views: the registration's folder and its views.
        masks: (H, W) bool in their order and size.
        record: of their quality.
        missed_px: by how much the outlines of those that are kept miss each other; None for two views.
    """

    scene: Path
    views: list[View]
    masks: list[np.ndarray]
    record: dict[str, Any]
    missed_px: float | None


def write_found_masks(
    args: argparse.Namespace, method: str, network: SalientObjectNetwork | None = None, segmenter: PromptedSegmenter | None = None
) -> None:
    """Find the masks of a registered scene, and write its cameras folder."""
    start_s = time.monotonic()
    views, model = read_views(args.scene)
    images = [view.image_path for view in views]
    saliency = None if network is None else find_maps(args.scene, network, images, args.image_width_px)
    exposure = estimate_exposure(args.scene, views)
    place = None if args.objects is None else read_center(args.objects, args.number)

    def find(scene: Path, views: list[View], model: SparseModel) -> FoundMasks:
        masks, record = find_masks(views, model, exposure, saliency, network, args.image_width_px, args.seed, place, segmenter)
        kept = [number for number, view in enumerate(views) if view.camera.name not in record["dropped"]]
        missed_px = measure_silhouette_misses_px([views[number].camera for number in kept], [masks[number] for number in kept])
        return FoundMasks(scene, views, masks, record, missed_px)

    with show_rejected_masks(images, args.rejected):
        found = find(args.scene, views, model)
    with scratch_directory(args.out, "straightened") as folder:
        bent_px, missed_px = None, found.missed_px or 0.0
        named = {view.camera.name: mask for view, mask in zip(views, found.masks, strict=True)}
        kept = {name: mask for name, mask in named.items() if name not in found.record["dropped"]}
        # Of several objects, one is found by its place, which is that of the bent cameras.
        if place is None and missed_px > MOST_MISSED_PX and straighten_scene(args.scene, views, kept, network, folder):
            with suppress(StepError):
                straight = find(folder, *read_views(folder))
                if (straight.missed_px or 0.0) < missed_px:
                    found, bent_px = straight, missed_px
        record = found.record | {"method": method, "seconds": round(time.monotonic() - start_s, 2)}
        if network is not None:
            record |= {"network": network.name, "segmenter": None if segmenter is None else segmenter.name}
        dropped = set(record["dropped"])
        write_segmented(found.scene, args.out, found.views, found.masks, dropped, record, exposure, found.missed_px, bent_px)
