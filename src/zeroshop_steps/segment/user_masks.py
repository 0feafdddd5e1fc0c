"""Take the masks that came with the photos; the registration has undistorted them with their images.

They are judged like masks that were found: one that contradicts the others is left out.
"""

import argparse
import time
from pathlib import Path

from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.mask_agreement import judged
from zeroshop_steps.segment.mask_quality import check_enough, quality_record
from zeroshop_steps.segment.record import add_common_arguments, failing_as_result, how_found, shown_if_rejected, write_segmented


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--capture", type=Path, help="the capture; how its masks were found stands in its segmentation.json")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    start_s = time.monotonic()
    with failing_as_result(args):
        views, _ = read_views(args.scene)
        if not (Path(args.scene) / "masks").is_dir():
            raise StepError(f"{args.scene} has no masks; give their folder in objects.tsv, or segment by support_plane")
        masks, names = [view.mask() for view in views], [view.camera.name for view in views]
        _, qualities = judged(masks, [view.camera for view in views])
        with shown_if_rejected([view.image_path for view in views], args.rejected):
            check_enough(qualities, names, masks)
        record = how_found(args.capture) | quality_record(qualities, names) | {"seconds": round(time.monotonic() - start_s, 2)}
        write_segmented(args.scene, args.out, views, masks, set(record["dropped"]), record)
