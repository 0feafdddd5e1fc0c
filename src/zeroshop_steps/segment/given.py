"""Take the masks that came with the photos; the registration has undistorted them with their images."""

import argparse
from pathlib import Path

from zeroshop_steps.errors import StepError
from zeroshop_steps.finish.views import read_views
from zeroshop_steps.segment.record import add_common_arguments, failing_as_result, write_segmented


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    with failing_as_result(args):
        views, _ = read_views(args.scene)
        if not (Path(args.scene) / "masks").is_dir():
            raise StepError(f"{args.scene} has no masks; give their folder in objects.tsv, or segment by support_plane")
        write_segmented(args.scene, args.out, views, [view.mask() for view in views], set(), {"method": "given"})
