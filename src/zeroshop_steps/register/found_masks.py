"""Masks of photos by a salient-object network: enough to register the object alone, and to check cameras that little else holds.

The network takes the thing in the middle of each photo. Masks that show something else are found by the registration.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.images import write_mask
from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.geometry.sparse_files import read_reconstruction
from zeroshop_steps.networks.salient_object import IMAGE_DEVIATION, IMAGE_MEAN, SalientObjectNetwork
from zeroshop_steps.register.image_set import MIN_IMAGES, ImageSet
from zeroshop_steps.register.neighbour_agreement import check_neighbours
from zeroshop_steps.register.outline_check import measure_outline_misses_px
from zeroshop_steps.register.record import RegistrationFailed
from zeroshop_steps.runtime.files import scratch_directory

WIDTH_PX = 480  # of the network's answers: finer ones cost time and bring nothing to features
THIN_OBSERVATIONS = 250
"""Points seen by an image, in the mean. On plain tables, cameras with 80 to 170 were bent or folded at times; print gives a thousand."""

ROUGH_MISSED_PX = 15.0
"""As `outline_check.MOST_MISSED_PX`, of masks that only a network has made: 1.5 to 5.7 with right cameras of a bowl and of a white
pitcher on a white table, 10 where they were bent by 3 %, 77 where they were folded. Bent ones are left to the segmentation, whose masks are
finer."""
CHECKED_VIEWS = 20  # at most, evenly spread: the network takes seconds for each, and cameras that are bent are so all around


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the network."""
    parser.add_argument("--saliency-weights", type=Path, help="ONNX file of a salient-object network; without it, masks must be given")
    parser.add_argument("--saliency-mean", type=float, nargs=3, default=IMAGE_MEAN, help="of its images, taken off (default: %(default)s)")
    parser.add_argument(
        "--saliency-deviation", type=float, nargs=3, default=IMAGE_DEVIATION, help="of its images, divided by (default: %(default)s)"
    )


def load_network(args: argparse.Namespace) -> SalientObjectNetwork | None:
    """The network that the command line names, if it names one. Raises StepError where it cannot be read."""
    if args.saliency_weights is None:
        return None
    return SalientObjectNetwork(args.saliency_weights, args.saliency_mean, args.saliency_deviation)


def find_masks(image_set: ImageSet, network: SalientObjectNetwork, folder: Path) -> ImageSet:
    """The images in which the network sees a thing, with masks that are written to `folder`.

    Raises:
        RegistrationFailed: it sees one in too few.
    """
    found = network.find_main_things(image_set.images, image_set.sizes_px, WIDTH_PX)
    chosen, masks = _write_useful(found, image_set.images, folder)
    if len(chosen) < MIN_IMAGES:
        raise RegistrationFailed(
            f"{network.path} sees something that stands out in {len(chosen)} of {len(found)} photos only", {"registered": 0}
        )
    return replace(
        image_set,
        images=tuple(image_set.images[index] for index in chosen),
        masks=tuple(masks),
        sizes_px=tuple(image_set.sizes_px[index] for index in chosen),
        sources=tuple(image_set.sources[index] for index in chosen) if image_set.sources else (),
    )


def is_thin(record: dict[str, Any]) -> bool:
    """Whether so few points hold the cameras that they may be bent or folded although they agree with each other."""
    return record["points"] * record["mean_track_length"] < THIN_OBSERVATIONS * record["registered"]


def check_by_found_masks(folder: Path, record: dict[str, Any], network: SalientObjectNetwork) -> dict[str, Any]:
    """Check cameras that were found without masks by those of a network: their outlines, and the pictures of neighbours.

    Args:
        folder: the registration.
        record: its record.

    Returns:
        The record with the figures of the checks.

    Raises:
        RegistrationFailed: the outlines miss each other, or sides that look alike lie on each other.
    """
    views, model = read_views(folder)[0], read_reconstruction(folder / "sparse")
    views = views[:: math.ceil(len(views) / CHECKED_VIEWS)]
    found = network.find_main_things(
        [view.image_path for view in views], [(view.camera.width_px, view.camera.height_px) for view in views], WIDTH_PX
    )
    record = record | {"checked_by": network.path.name}
    with scratch_directory(folder, "masks") as scratch:
        chosen, paths = _write_useful(found, [view.image_path for view in views], scratch)
        masked = [replace(views[index], mask_path=path) for index, path in zip(chosen, paths, strict=True)]
        missed_px = measure_outline_misses_px(masked, [found[index] for index in chosen])
        record |= {"outlines_miss_px": None if missed_px is None else round(missed_px, 2)}
        if missed_px is not None and missed_px > ROUGH_MISSED_PX:
            raise RegistrationFailed(
                f"the cameras are wrong: in half of the photos, the outline of the thing in the middle misses the others by"
                f" {missed_px:.1f} px or more (of 1000); put the object on a surface with more print",
                record,
                model,
            )
        if len(masked) >= MIN_IMAGES:
            check_neighbours(masked, record, model)
    return record


def _write_useful(masks: Sequence[np.ndarray], images: Sequence[Path], folder: Path) -> tuple[list[int], list[Path]]:
    """Numbers of the masks that show something, and not all of the photo, and the files that they are written to, named by the images."""
    chosen = [index for index, mask in enumerate(masks) if mask.any() and not mask.all()]
    paths = [folder / f"{images[index].stem}.png" for index in chosen]
    for path, index in zip(paths, chosen, strict=True):
        write_mask(path, masks[index])
    return chosen, paths
