"""Masks of photos whose cameras are not known, by a salient-object network: enough to register the object alone.

The network takes the thing in the middle of each photo. Masks that show something else are found by the registration.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from zeroshop_steps.geometry.images import write_mask
from zeroshop_steps.networks.salient_object import IMAGE_DEVIATION, IMAGE_MEAN, SalientObjectNetwork
from zeroshop_steps.register.image_set import MIN_IMAGES, ImageSet
from zeroshop_steps.register.record import RegistrationFailed

WIDTH_PX = 480  # of the network's answers: finer ones cost time and bring nothing to features


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
    chosen, masks = [], []
    for index, (path, mask) in enumerate(zip(image_set.images, found, strict=True)):
        if mask.any() and not mask.all():
            chosen.append(index)
            masks.append(folder / f"{path.stem}.png")
            write_mask(masks[-1], mask)
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
