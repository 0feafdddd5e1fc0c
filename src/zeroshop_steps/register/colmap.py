"""Classical structure from motion with COLMAP: SIFT, exhaustive matching, one shared camera, incremental mapping.

What it finds is checked against the masks, if there are any: they had no part in it. Then images and masks are undistorted.
Too few registered images, or cameras that the images contradict, are a failure with a reason.
"""

import argparse
import math
import tempfile
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.cache import Cached
from zeroshop_steps.register.image_set import ImageSet, read_image_set
from zeroshop_steps.register.mapping import map_incrementally, mapping_options
from zeroshop_steps.register.record import (
    OBJECT_ONLY,
    RegistrationFailed,
    add_common_arguments,
    lens_figures,
    model_figures,
    write_registration,
)
from zeroshop_steps.register.repair import place_again, refine_robustly, repaired, without_images
from zeroshop_steps.register.sift import SiftOptions, extract, match
from zeroshop_steps.register.tilted import add_stretched_features, weak_images
from zeroshop_steps.register.undistort import undistort
from zeroshop_steps.register.verdict import Limits, Verdict, judge

CACHED = Cached(inputs=("capture/images", "capture/masks"), ignored=("threads",))


@dataclass(frozen=True)
class ColmapOptions:
    """Parameters of the method.

    Attributes:
        sift: extraction and matching.
        object_only: features inside the masks only, for images without a surface.
        weak_matches, weak_share: views with fewer verified matches, over all pairs, or less than this share of what a
            well-matched view has, get features of a stretched copy, too.
        tilt: how much that copy is stretched (5 suits a surface seen under 8 to 20 degrees).
        min_share, min_images: the fewest images that must be registered, as a share of all and as a number.
        max_dropped: rounds in which images that the pictures contradict are placed again or left out.
        limits: from where on a model counts as wrong.
    """

    sift: SiftOptions = field(default_factory=SiftOptions)
    object_only: bool = False
    weak_matches: int = 1000
    weak_share: float = 0.5
    tilt: float = 5.0
    min_share: float = 0.8
    min_images: int = 8
    max_dropped: int = 6
    limits: Limits = field(default_factory=Limits)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    defaults = ColmapOptions()
    parser.add_argument("--min-share", type=float, default=defaults.min_share, help="share of images needed (default: %(default)s)")
    parser.add_argument("--min-images", type=int, default=defaults.min_images, help="number of images needed (default: %(default)s)")
    parser.add_argument(
        "--max-features", type=int, default=defaults.sift.max_features, help="SIFT features per image (default: %(default)s)"
    )
    parser.add_argument("--focal-px", type=float, default=None, help="focal length if known; else EXIF or an estimate")
    parser.add_argument("--seed", type=int, default=defaults.sift.seed, help="seed of all RANSAC loops (default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    options = ColmapOptions(object_only=args.scene in OBJECT_ONLY, min_share=args.min_share, min_images=args.min_images)
    features = replace(options.sift, max_features=args.max_features, focal_px=args.focal_px, seed=args.seed, threads=args.threads)
    options = replace(options, sift=features)
    image_set = read_image_set(args.capture)
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    write_registration(args.out, args.keep_going, lambda folder: register(image_set, folder, options))


def register(image_set: ImageSet, out: Path, options: ColmapOptions) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: too few images, or an inconsistent model.
    """
    seconds: dict[str, float] = {}
    lap_s = start_s = time.monotonic()

    def lap(name: str) -> None:
        nonlocal lap_s
        seconds[name], lap_s = round(time.monotonic() - lap_s, 3), time.monotonic()

    count = len(image_set.images)
    needed = max(options.min_images, math.ceil(options.min_share * count))
    figures: dict[str, Any] = {"method": "colmap", "images": count, "registered": 0, "seconds": seconds, "parameters": asdict(options)}
    figures["versions"] = {"pycolmap": pycolmap.__version__}
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".colmap.") as scratch_name:
        scratch = Path(scratch_name)
        database = scratch / "database.db"
        figures["median_features"] = extract(database, image_set, options.sift, scratch / "masks" if options.object_only else None)
        lap("extract")
        match(database, options.sift)
        lap("match")
        weak = [] if options.object_only else weak_images(database, options.weak_matches, options.weak_share)
        if weak:
            add_stretched_features(database, image_set, weak, options.tilt, options.sift)
        figures["stretched"] = weak
        lap("stretch")
        mapper = mapping_options(min(needed, count), options.sift.seed)
        model = map_incrementally(database, image_set.images[0].parent, scratch / "models", mapper)
        lap("map")
        if model is not None:
            model, verdict = _settled(model, image_set, database, scratch, options, figures)
            lap("repair")
    registered = model.num_reg_images() if model else 0
    if model is None or registered < needed:
        raise RegistrationFailed(
            f"{registered} of {count} images registered, at least {needed} are needed; take more pictures with more overlap, "
            + (
                "or register the whole scene, with its ground"
                if options.object_only
                else "or put the object on a strongly textured surface"
            ),
            figures,
        )
    pinhole_model = undistort(model, image_set, out)
    lap("undistort")
    figures["lens"] = lens_figures(model)
    figures |= model_figures(pinhole_model) | {"consistency": verdict.figures()}
    seconds["total"] = round(time.monotonic() - start_s, 3)
    if verdict.reason:
        raise RegistrationFailed(verdict.reason, figures, pinhole_model)
    return figures


def _settled(
    model: pycolmap.Reconstruction, image_set: ImageSet, database: Path, scratch: Path, options: ColmapOptions, figures: dict[str, Any]
) -> tuple[pycolmap.Reconstruction, Verdict]:
    """Refine, place suspicious images again, and leave out those that the pictures contradict even then."""
    images = image_set.images[0].parent
    model, again = repaired(model, database, images, scratch, options.sift.seed)
    verdict = judge(model, image_set, database, options.limits)
    dropped: list[str] = []
    for _ in range(options.max_dropped):
        if verdict.reason is None or model.num_reg_images() - len(verdict.culprits) < options.min_images:
            break
        names = list(verdict.culprits)
        if set(names) <= set(again):
            dropped += names
            model = without_images(model, names)
        else:
            again += names
            model = place_again(model, names, database, images, scratch, options.sift.seed)
        refine_robustly(model)
        verdict = judge(model, image_set, database, options.limits)
    figures |= {"placed_again": again, "left_out": dropped}
    return model, verdict
