"""Classical structure from motion with COLMAP: SIFT, matching of pairs, a camera for each lens, incremental mapping.

The cameras are checked against the masks, if there are any, which had no part in finding them. Then images and masks are
undistorted. Too few registered images, or cameras that the images contradict, are a failure with a reason.
"""

import argparse
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.register.consistency import ConsistencyLimits
from zeroshop_steps.register.image_set import ImageSet, read_image_set
from zeroshop_steps.register.record import (
    OBJECT_ONLY,
    PHOTO_SCENES,
    RegistrationFailed,
    add_common_arguments,
    add_estimation_arguments,
    write_registration,
)
from zeroshop_steps.register.sift import SiftOptions, choose_name_pairs, extract_features, find_focal_source, fit_to_count, match_features
from zeroshop_steps.register.still_background import (
    STILL_REMEDY,
    STILL_SHARE,
    describe_still,
    measure_still_share,
    verify_without_still,
)
from zeroshop_steps.register.strange_sides import check_sides
from zeroshop_steps.register.stretched_features import VERTICAL, add_stretched_features, find_flattened, find_weak_images
from zeroshop_steps.register.structure import Stopwatch, StructureOptions, reconstruct
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.files import scratch_directory

CACHED = Cached(inputs=("capture/images", "capture/masks"), ignored=("threads",))


@dataclass(frozen=True)
class ColmapOptions:
    """Parameters of the method.

    Attributes:
        sift: extraction and matching.
        object_only: features inside the masks only, for images without a surface.
        leave_out: whether images may be of another scene, which are left out then.
        weak_matches, weak_share: views with fewer verified matches, over all pairs, or less than this share of what a
            well-matched view has, get features of a stretched copy, too.
        tilt: how much that copy is stretched (5 suits a surface seen under 8 to 20 degrees).
        min_share, min_images: the fewest images that must be registered, as a share of all and as a number.
        max_dropped: rounds in which images that the pictures contradict are placed again or left out.
        limits: limits of the checks, beyond which a model is wrong.
    """

    sift: SiftOptions = field(default_factory=SiftOptions)
    object_only: bool = False
    leave_out: bool = False
    weak_matches: int = 1000
    weak_share: float = 0.5
    tilt: float = 5.0
    min_share: float = 0.8
    min_images: int = 8
    max_dropped: int = 6
    limits: ConsistencyLimits = field(default_factory=ConsistencyLimits)


METHOD = {"title": "COLMAP", "rank": 0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)
    defaults = ColmapOptions()
    add_estimation_arguments(parser, defaults.min_share, defaults.min_images, defaults.sift.seed)
    add_own_arguments(parser)
    parser.add_argument("--focal-px", type=float, default=None, help="focal length if known; else EXIF or an estimate")


def add_own_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that this method alone has."""
    features = SiftOptions().max_features
    parser.add_argument("--max-features", type=int, default=features, help="SIFT features per image (default: %(default)s)")


def read_options(args: argparse.Namespace) -> ColmapOptions:
    """The options that the command line gives."""
    features = SiftOptions(max_features=args.max_features, focal_px=args.focal_px, seed=args.seed, threads=args.threads)
    return ColmapOptions(
        sift=features,
        object_only=args.scene in OBJECT_ONLY,
        leave_out=args.scene in PHOTO_SCENES,
        min_share=args.min_share,
        min_images=args.min_images,
    )


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    options, image_set = read_options(args), read_image_set(args.capture)
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    write_registration(args.out, lambda folder: register(image_set, folder, options))


def register(image_set: ImageSet, out: Path, options: ColmapOptions) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: too few images, or an inconsistent model.
    """
    stopwatch = Stopwatch()
    count = len(image_set.images)
    options = replace(options, sift=fit_to_count(options.sift, count))
    figures: dict[str, Any] = {"method": "colmap", "images": count, "registered": 0, "seconds": stopwatch.seconds}
    figures |= {"parameters": asdict(options), "versions": {"pycolmap": pycolmap.__version__}}
    with scratch_directory(out, "colmap") as scratch:
        database = scratch / "database.db"
        figures["median_features"] = extract_features(database, image_set, options.sift, scratch / "masks" if options.object_only else None)
        figures["focal_source"] = "given" if options.sift.focal_px is not None else find_focal_source(database)
        stopwatch.lap("extract")
        pairs = choose_name_pairs(image_set, options.sift, options.object_only)
        stopwatch.lap("choose")
        match_features(database, options.sift, pairs)
        figures["matched_pairs"] = len(image_set.images) * (len(image_set.images) - 1) // 2 if pairs is None else len(pairs)
        figures["still_share"] = measure_still_share(database, image_set)
        still = figures["still_share"] > STILL_SHARE and not options.object_only
        if still:
            verify_without_still(database, image_set, options.sift.seed)
            figures["warnings"] = [f"{describe_still(figures['still_share'])}: the cameras are found from what turns; {STILL_REMEDY}"]
        stopwatch.lap("match")
        weak = [] if options.object_only else find_weak_images(database, options.weak_matches, options.weak_share)
        flattened = find_flattened(database, weak)
        if not options.leave_out:
            # Photos that are not flattened gain nothing. On plain rendered grounds that was not measured: all are stretched there.
            flattened = {name: flattened.get(name, VERTICAL) for name in weak}
        if flattened:
            add_stretched_features(database, image_set, flattened, options.tilt, options.sift, pairs)
            if still:
                verify_without_still(database, image_set, options.sift.seed)
        figures["stretched"] = sorted(flattened)
        stopwatch.lap("stretch")
        needs = StructureOptions(
            options.min_share,
            options.min_images,
            options.max_dropped,
            options.limits,
            options.sift.seed,
            options.object_only,
            options.leave_out,
        )
        try:
            figures = reconstruct(database, image_set, out, needs, figures, stopwatch)
            tested = None if pairs is None else {frozenset(Path(name).stem for name in pair) for pair in pairs}
            return check_sides(out, figures, None if tested is None else lambda one, other: frozenset((one, other)) not in tested)
        except RegistrationFailed as error:
            if not still:
                raise
            reason = f"{describe_still(figures['still_share'])}, and what turns is too little to find the cameras ({error}); {STILL_REMEDY}"
            raise RegistrationFailed(reason, error.figures, error.rejected) from None
