"""A network that knows sizes from experience gives the scale (MASt3R; Leroy et al. 2024): photos of the object and of the scene go in.

The thesis takes two photos of the object and four of the empty scene, because the network misjudges near views alone. The
network itself is not here yet: the step says what it lacks.
"""

import argparse
from pathlib import Path

from zeroshop_steps.errors import StepError
from zeroshop_steps.height.record import Scale, Subject, add_common_arguments, write_height
from zeroshop_steps.methods import HEIGHTS, WEIGHTS_FOLDER


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    parser.add_argument("--marker-images", type=Path, help="folder of photos of the empty scene; a board in them is not needed")
    default = WEIGHTS_FOLDER / HEIGHTS["mast3r"].weights[0]
    parser.add_argument("--weights", type=Path, default=default, help="the network's weights (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write height.json."""
    if not args.weights.is_file():
        raise StepError(
            f"height by mast3r lacks the weights {args.weights} (licence CC BY-NC-SA 4.0, from the authors of MASt3R); give the height "
            "as height_m, or measure it with a printed board: height_method marker needs no weights"
        )
    write_height(args, "mast3r", scale_of)


def scale_of(subject: Subject) -> Scale:
    """The scale that the network predicts. Raises StepError: the network is not part of this version."""
    raise StepError("height by mast3r lacks its network, which this version does not have; use height_method known or marker")
