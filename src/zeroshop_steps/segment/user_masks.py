"""Use the masks that the user gave; the registration has undistorted them with their images.

They are checked like masks that were found: one that contradicts the others is left out.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

from zeroshop_steps.geometry.cameras.registered_views import read_mask_record, read_views
from zeroshop_steps.register.scene.record import read_registration
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.quality.mask_agreement import assess_masks
from zeroshop_steps.segment.quality.mask_quality import check_enough_good, describe_quality
from zeroshop_steps.segment.record import add_common_arguments, show_rejected_masks, write_segmented

METHOD = {"given": True, "runtime_min": 60}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--capture", type=Path, help="the capture; its segmentation.json says how its masks were found")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    start_s = time.monotonic()
    views, _ = read_views(args.scene)
    if not (Path(args.scene) / "masks").is_dir():
        raise StepError(f"{args.scene} has no masks; give their folder in objects.tsv, or segment by support_plane")
    masks, names = [view.mask() for view in views], [view.camera.name for view in views]
    _, qualities = assess_masks(masks, [view.camera for view in views])
    wrong = read_registration(args.scene).get("consistency", {}).get("wrong_masks", [])
    qualities = [
        replace(quality, fault=quality.fault or "its rays miss the masks of most other views") if name in wrong else quality
        for quality, name in zip(qualities, names, strict=True)
    ]
    with show_rejected_masks([view.image_path for view in views], args.rejected):
        check_enough_good(qualities, names, masks)
    record = read_mask_record(args.capture) | describe_quality(qualities, names) | {"seconds": round(time.monotonic() - start_s, 2)}
    write_segmented(args.scene, args.out, views, masks, set(record["dropped"]), record)
