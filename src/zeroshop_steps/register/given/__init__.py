"""Cameras that come with the capture (cameras.json): an arm, a board, a phone or another program knows them.

SIFT's matches, which know of no poses, tell how they are meant: usual faults (axes, inverse, delay, hand-eye transform) are named and
refused. Then they are adjusted to the pictures, with what was stated of their places as priors, and checked like any registration. Their
metres are the unit. Images without a pose are placed among the others.
"""

import argparse

from zeroshop_steps.capture.cameras_json import FILE, read_given_cameras
from zeroshop_steps.register.colmap import add_own_arguments, read_colmap_options
from zeroshop_steps.register.pipeline import add_matching_arguments
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError

CACHED = Cached(inputs=("capture/images", "capture/masks", "capture/cameras.json"), ignored=("threads",))

METHOD = {"title": "given", "rank": 2, "given_cameras": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    add_own_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    from zeroshop_steps.register.given.solve import register

    path = args.capture / FILE
    if not path.is_file():
        raise StepError(f"{path} does not exist: no cameras came with this capture; use --method colmap, or import one (zeroshop import)")
    given, image_set = read_given_cameras(path), read_image_set(args.capture)
    options = read_colmap_options(args)
    write_registration(args.out, lambda folder: register(image_set, given, folder, options))
