"""Classical structure from motion with COLMAP: SIFT, matching of pairs, a camera for each lens, incremental mapping.

The cameras are checked against the masks, if there are any, which had no part in finding them. Then images and masks are
undistorted. Too few registered images, or cameras that the images contradict, are a failure with a reason.
"""

import argparse
import shutil
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.geometry.cameras import read_sparse_model
from zeroshop_steps.register.features.sift import SiftOptions, extract_features, find_focal_source, fit_to_count, refine
from zeroshop_steps.register.features.tilted_features import VERTICAL, add_tilted_features, find_foreshortened, find_weak_images
from zeroshop_steps.register.matching.match_coverage import delete_pairs_of_low_coverage
from zeroshop_steps.register.matching.pair_selection import choose_name_pairs
from zeroshop_steps.register.matching.turntable import (
    TURNTABLE_REMEDY,
    StationaryMatches,
    measure_stationary,
    verify_without_stationary,
)
from zeroshop_steps.register.matching.verified_matches import match_features
from zeroshop_steps.register.pipeline import StructureOptions, add_matching_arguments, read_structure_options, reconstruct
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set
from zeroshop_steps.register.scene.record import RegistrationFailed, Stopwatch, TooFewRegistered
from zeroshop_steps.register.verification.consistency import FOLDED, WRONG
from zeroshop_steps.register.verification.view_coverage import LEAST_SPREAD_DEG, LEAST_TURN_DEG, check_spread
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import scratch_directory

CACHED = Cached(inputs=("capture/images", "capture/masks"), ignored=("threads",))

Start = Callable[[Path], pycolmap.Reconstruction]
"""Gives a model from a database of verified matches."""


@dataclass(frozen=True)
class ColmapOptions:
    """Parameters of the method.

    Attributes:
        sift: extraction and matching.
        structure: of the reconstruction; where it is of the object only, features come from inside the masks.
        weak_matches, weak_share: views with fewer verified matches, over all pairs, or less than this share of what a
            well-matched view has, get features of a stretched copy, too.
        tilt: how much that copy is stretched (5 suits a surface seen under 8 to 20 degrees).
    """

    sift: SiftOptions = field(default_factory=SiftOptions)
    structure: StructureOptions = field(default_factory=StructureOptions)
    weak_matches: int = 1000
    weak_share: float = 0.5
    tilt: float = 5.0


Match = Callable[[Path, ImageSet, ColmapOptions, dict[str, Any], Stopwatch], list[tuple[str, str]] | None]
"""What fills a database with features and verified matches, as `match_images` does."""

METHOD = {"title": "COLMAP", "rank": 0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    add_own_arguments(parser)


def add_own_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that this method alone has."""
    features = SiftOptions().max_features
    parser.add_argument("--max-features", type=int, default=features, help="SIFT features per image (default: %(default)s)")


def read_options(args: argparse.Namespace) -> ColmapOptions:
    """The options that the command line gives."""
    features = SiftOptions(max_features=args.max_features, focal_px=args.focal_px, seed=args.seed, threads=args.threads)
    return ColmapOptions(features, read_structure_options(args))


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    options, image_set = read_options(args), read_image_set(args.capture)
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR
    write_registration(args.out, lambda folder: register(image_set, folder, options))


def register(image_set: ImageSet, out: Path, options: ColmapOptions, match: Match | None = None) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Args:
        image_set: what to register.
        out: folder to fill.
        options: see `ColmapOptions`.
        match: fills the database; None for `match_images`.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: too few images, or an inconsistent model.
    """
    count = len(image_set.images)
    try:
        return _register_by(image_set, out, replace(options, sift=fit_to_count(options.sift, count)), match)
    except TooFewRegistered as error:
        finer = None if match else refine(options.sift, error.figures["first_octave"], count)
        if finer is None:
            raise
        coarser = {"reason": str(error), "seconds": error.figures["seconds"]}
    print(f"{coarser['reason']}; trying finer features")
    return _register_by(image_set, out, replace(options, sift=finer), None, {"coarser_features": coarser})


def _register_by(
    image_set: ImageSet, out: Path, options: ColmapOptions, match: Match | None, facts: dict[str, Any] | None = None
) -> dict[str, Any]:
    stopwatch = Stopwatch()
    figures: dict[str, Any] = {"method": "colmap", "images": len(image_set.images), "registered": 0, "seconds": stopwatch.seconds}
    figures |= {"parameters": asdict(options), "versions": {"pycolmap": pycolmap.__version__}, **(facts or {})}
    return match_and_reconstruct(image_set, out, options, figures, stopwatch, match=match)


def match_and_reconstruct(
    image_set: ImageSet,
    out: Path,
    options: ColmapOptions,
    figures: dict[str, Any],
    stopwatch: Stopwatch,
    start: Start | None = None,
    match: Match | None = None,
) -> dict[str, Any]:
    """As `register`, with a record that was begun: `figures` is completed in place. `start` gives a model of the matches to begin with."""
    structure = options.structure
    with scratch_directory(out, "colmap") as scratch:
        database = scratch / "database.db"
        pairs = (match or match_images)(database, image_set, options, figures, stopwatch)
        first = start(database) if start else None
        tested = None if pairs is None else {frozenset(Path(name).stem for name in pair) for pair in pairs}
        may_match = None if tested is None else lambda one, other: frozenset((one, other)) not in tested
        figures_before = deepcopy(figures)
        try:
            record = reconstruct(database, image_set, out, structure, figures, stopwatch, may_match, structure.object_only, first)
            _check_spread(out, record, LEAST_SPREAD_DEG if _read_stationary(figures, options) is None else LEAST_TURN_DEG)
            return record
        except RegistrationFailed as error:
            if start is None and structure.leave_out and not structure.object_only and str(error).startswith(WRONG):
                found = _reconstruct_from_covering_pairs(database, image_set, out, structure, figures_before, stopwatch, error)
                if found is not None:
                    return found
            still = _read_stationary(figures, options)
            if still is None:
                raise
            reason = f"{still.describe()}, and what turns is too little to find the cameras ({error}); {TURNTABLE_REMEDY}"
            if str(error).startswith(FOLDED):  # photos of equal sides do not move either
                reason = f"{error}. Or {still.describe()}: then {TURNTABLE_REMEDY}"
            raise type(error)(reason, error.figures, error.rejected) from None


def _check_spread(folder: Path, figures: dict[str, Any], least_deg: float) -> None:
    """Raise RegistrationFailed where all cameras look from one side."""
    try:
        check_spread(list(read_sparse_model(folder / "sparse").cameras), least_deg)
    except StepError as error:
        raise RegistrationFailed(str(error), figures) from None


def _reconstruct_from_covering_pairs(
    database: Path,
    image_set: ImageSet,
    out: Path,
    structure: StructureOptions,
    figures: dict[str, Any],
    stopwatch: Stopwatch,
    wrong: RegistrationFailed,
) -> dict[str, Any] | None:
    """The record of cameras from those pairs alone whose matches lie all over the pictures, where `wrong` ones came of all; None without.

    Such cameras must pass all checks, and the pictures of neighbours must show the same.
    """
    scratch = database.parent / "wide"
    scratch.mkdir()
    shutil.copy(database, scratch / database.name)
    figures["narrow_pairs"] = delete_pairs_of_low_coverage(scratch / database.name)
    for part in ("images", "masks", "sparse"):
        shutil.rmtree(out / part, ignore_errors=True)
    try:
        compared = replace(structure, compare_pictures=True)
        record = reconstruct(scratch / database.name, image_set, out, compared, figures, stopwatch, all_matches=database)
    except RegistrationFailed as error:
        print(f"pairs of photos whose matches lie all over the pictures do not give the cameras either: {error}")
        return None
    if wrong.figures.get("gap_evidence", {}).get("folded") and "gap_evidence" in record:
        print("pairs of photos whose matches lie all over the pictures leave the gap: the photos across it may be those that are left out")
        return None
    record["warnings"] = [
        *record.get("warnings", []),
        f"sides of the object look alike, and cameras from all pairs of photos were refused ({wrong}); they were found from those"
        f" pairs whose matches lie all over the pictures, without {figures['narrow_pairs']} others",
    ]
    return record


def match_images(
    database: Path, image_set: ImageSet, options: ColmapOptions, figures: dict[str, Any], stopwatch: Stopwatch
) -> list[tuple[str, str]] | None:
    """Write the features of all images and their verified matches into a new database; completes `figures`.

    Returns:
        The names of the pairs that were matched; None for all pairs.
    """
    structure = options.structure
    mask_folder = database.parent / "masks" if structure.object_only else None
    figures["median_features"], figures["first_octave"] = extract_features(database, image_set, options.sift, mask_folder)
    figures["focal_source"] = "given" if options.sift.focal_px is not None else find_focal_source(database)
    stopwatch.lap("extract")
    pairs = choose_name_pairs(image_set, options.sift, structure.object_only)
    stopwatch.lap("choose")
    match_features(database, options.sift, pairs)
    figures["matched_pairs"] = len(image_set.images) * (len(image_set.images) - 1) // 2 if pairs is None else len(pairs)
    found = measure_stationary(database, image_set, options.sift.seed)
    figures |= {f"still_{name}": share for name, share in asdict(found).items()}
    still = _read_stationary(figures, options)
    figures["still_background"] = still is not None
    if still is not None:
        verify_without_stationary(database, image_set, options.sift.seed)
        figures["warnings"] = [f"{still.describe()}: the cameras are found from what turns; {TURNTABLE_REMEDY}"]
    stopwatch.lap("match")
    weak = [] if structure.object_only else find_weak_images(database, options.weak_matches, options.weak_share)
    flattened = find_foreshortened(database, weak)
    if not structure.leave_out:
        # Photos that are not flattened gain nothing. On plain rendered grounds that was not measured: all are stretched there.
        flattened = {name: flattened.get(name, VERTICAL) for name in weak}
    if flattened:
        match_features(database, options.sift, add_tilted_features(database, image_set, flattened, options.tilt, options.sift, pairs))
        if still is not None:
            verify_without_stationary(database, image_set, options.sift.seed)
    figures["stretched"] = sorted(flattened)
    stopwatch.lap("stretch")
    return pairs


def _read_stationary(figures: dict[str, Any], options: ColmapOptions) -> StationaryMatches | None:
    """The matches that stand still, where that is the background of a whole scene; else None."""
    found = StationaryMatches(*(figures[f"still_{field.name}"] for field in fields(StationaryMatches)))
    return found if found.are_background and not options.structure.object_only else None
