"""Use the true cameras of a rendered capture: shows what registration costs in quality.

Copies images and masks as they are, takes the cameras from `CAPTURE/truth` and triangulates sparse points from SIFT
matches with those cameras held fixed, because later stages start from sparse points.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.register.features import sift
from zeroshop_steps.register.mapping.mapper import triangulate_points
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.registration import add_common_arguments, write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import OBJECT_ONLY, describe_model
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import scratch_directory

CACHED = Cached(inputs=("capture/images", "capture/masks", "capture/truth"), ignored=("threads",))

METHOD = {"rank": 1, "true_cameras": True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    truth = args.capture / "truth"
    if not (truth / "cameras.bin").is_file() and not (truth / "cameras.txt").is_file():
        raise StepError(f"{truth} holds no COLMAP model of true cameras; only virtual captures have one, use --method colmap for photos")
    image_set = read_image_set(args.capture)
    options = sift.SiftOptions(threads=args.threads)
    write_registration(args.out, lambda folder: register(image_set, truth, args.scene, folder, options), estimated=False)


def register(image_set: ImageSet, truth: Path, scene: str, out: Path, options: sift.SiftOptions) -> dict[str, Any]:
    """Write images/, masks/ and sparse/ with the cameras of the COLMAP model `truth`; returns the record for registration.json."""
    out.mkdir(parents=True, exist_ok=True)
    start_s = time.monotonic()
    true_model = read_reconstruction(truth)
    true_images = {Path(image.name).stem: image for image in true_model.images.values() if image.has_pose}
    for path in image_set.images:
        if path.stem not in true_images:
            raise StepError(f"{truth} has no camera for image {path.name}; capture and truth do not belong together, capture again")
    cameras = {stem: true_model.cameras[image.camera_id] for stem, image in true_images.items()}
    with scratch_directory(out, "truth") as scratch:
        database = scratch / "database.db"
        sift.extract_features(database, image_set, options, scratch / "masks" if scene in OBJECT_ONLY else None, cameras)
        match_features(database, options)
        model = triangulate_points(database, image_set, {stem: image.cam_from_world() for stem, image in true_images.items()}, options.seed)
    undistort(model, image_set, out)
    return {
        "method": "truth",
        "images": len(image_set.images),
        **describe_model(model),
        "seconds": {"total": round(time.monotonic() - start_s, 3)},
        "versions": {"pycolmap": pycolmap.__version__},
    }
