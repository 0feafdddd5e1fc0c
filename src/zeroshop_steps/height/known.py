"""Take the scale from a known height: measured with a ruler (height_m in objects.tsv), or the true one of a rendered capture."""

import argparse

from zeroshop_steps.height.record import RULER_M, RegisteredObject, Scale, add_common_arguments, write_height
from zeroshop_steps.runtime.errors import StepError

METHOD = {"rank": 0, "given_height": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    write_height(args, "known", measure_scale)


def measure_scale(registered: RegisteredObject) -> Scale:
    """The scale that gives the object its known height. Raises StepError where none is given."""
    if registered.known_height_m is None:
        raise StepError(
            f"no height is given, and {registered.capture / 'capture.json'} has no known_height_m; give the height in metres as height_m,"
            " or use another height_method"
        )
    height_m, extent = registered.known_height_m, registered.pose.extent
    return Scale("known_height", height_m / extent, RULER_M / height_m, {"known_height_m": height_m})
