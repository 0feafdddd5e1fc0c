"""Choose the masks that poses are estimated from: confident detections that do not overlap.

The thesis prepares the masks of CNOS for FoundationPose in this way. Detections with a score below 0.2 are dropped. The others are
painted into one label map, the most confident first, and painted pixels are not painted again. A later detection keeps what is left
of its mask. If that is less than half, it was another hypothesis for the same object and is dropped. Reads and writes BOP's COCO JSON.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.detections import Detection, decode_mask, encode_mask, mask_to_box, read_detections, write_detections
from zeroshop_steps.bop.formats.models import list_objects
from zeroshop_steps.runtime.errors import StepError

LEAST_SCORE = 0.2  # of a detection, by the thesis
LEAST_LEFT = 0.5  # of a mask, by the thesis; with less, two hypotheses for one object would both be kept


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--detections", type=Path, required=True, help="BOP COCO result file with masks")
    parser.add_argument("--models", type=Path, required=True, help="folder of the models whose poses are wanted")
    parser.add_argument(
        "--least-score", type=float, default=LEAST_SCORE, help="score below which a detection is dropped (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, required=True, help="BOP COCO result file to write")


def run(args: argparse.Namespace) -> None:
    """Filter one result file."""
    found = read_detections(args.detections)
    strange = sorted({one.object_id for one in found} - set(there := list_objects(args.models)))
    if strange:
        raise StepError(
            f"{args.detections} names the objects {strange}, which have no model in {args.models}; it has {there}."
            " Detect and estimate with the same models"
        )
    kept = filter_detections(found, args.least_score, args.detections)
    write_detections(args.out, kept)
    print(f"{args.out}: {len(kept)} of {len(found)} detections")


def filter_detections(detections: Sequence[Detection], least_score: float, path: Path) -> list[Detection]:
    """The confident detections, image by image, the most confident first, with masks that do not overlap.

    Args:
        detections: of any number of images.
        least_score: those below are dropped.
        path: of the detections, for messages.

    Raises:
        StepError: a detection has no mask, or the masks of an image differ in size.
    """
    images: dict[tuple[int, int], list[Detection]] = {}
    for one in detections:
        if one.score >= least_score:
            images.setdefault((one.scene_id, one.image_id), []).append(one)
    return [kept for image in images.values() for kept in _paint_masks(image, path)]


def _paint_masks(detections: list[Detection], path: Path) -> list[Detection]:
    """The detections of one image with masks that do not overlap."""
    kept, taken = [], None
    for one in sorted(detections, key=lambda one: -one.score):
        place = f"scene {one.scene_id}, image {one.image_id}"
        if one.mask is None:
            raise StepError(f"{path}: a detection of object {one.object_id} in {place} has no segmentation; poses need masks")
        mask = decode_mask(one.mask)
        taken = np.zeros_like(mask) if taken is None else taken
        if mask.shape != taken.shape:
            raise StepError(
                f"{path}: masks in {place} are {taken.shape[1]} x {taken.shape[0]} px and {mask.shape[1]} x {mask.shape[0]} px;"
                " they must be of the image's size"
            )
        left = mask & ~taken
        if left.sum() >= max(LEAST_LEFT * mask.sum(), 1):
            kept.append(replace(one, mask=encode_mask(left), box_px=mask_to_box(left)))
            taken |= left
    return kept
