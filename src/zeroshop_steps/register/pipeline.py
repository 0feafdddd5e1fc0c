"""From a database of matches to cameras: map, refine, check against masks and image pairs, undistort. Shared by methods that match."""

import argparse
import math
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import pycolmap

from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.register.final_refinement import Improver
from zeroshop_steps.register.mapping.incremental import make_mapping_options, map_incrementally, map_submodels
from zeroshop_steps.register.mapping.reregistration import refine_robustly, register_again, remove_images, repair
from zeroshop_steps.register.matching.view_graph import describe_components, find_components
from zeroshop_steps.register.registration import add_common_arguments, add_estimation_arguments
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import (
    OBJECT_ONLY,
    PHOTO_SCENES,
    RegistrationFailed,
    Stopwatch,
    TooFewRegistered,
    describe_lenses,
    describe_model,
    name_missing,
)
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.submodels.merge import LEAST_IMAGES, merge_submodels
from zeroshop_steps.register.verification.consistency import ConsistencyLimits, ConsistencyReport, check_consistency, find_unsure
from zeroshop_steps.register.verification.duplicate_structure import MayMatch, check_duplicate_structure
from zeroshop_steps.register.verification.loop_gap import check_loop_gap
from zeroshop_steps.register.verification.photometric_consistency import check_photometric_consistency
from zeroshop_steps.register.verification.wide_baseline import check_wide_baseline

MANY_IMAGES = 30  # beyond them, adjusting all cameras together after each few images takes most of the time
LOOSE_OBSERVATIONS = 650
"""Points seen by an image, in the mean: with fewer, outlines are asked, too. On plain grounds, cameras with 314, 379 and 642 went from 2.7,
0.23 and 0.62 mm to 0.5, 0.21 and 0.17; with 690 and 694, from 0.26 and 0.26 to 0.33 and 0.43. Print gives a thousand and more."""
WRONG_MASKS_OF_OBJECT = 0.1
"""Share of the masks that may contradict the others where the object alone gave the matches: no ground holds the cameras then. Of two cans
side by side, photos of either were laid onto each other, 51 mm off, and 6 of 20 masks contradicted that."""
LEAST_COMMON_SHARE = 0.5
"""Share of the photos that must belong together: with fewer, nothing tells which of them show the object that is meant."""


@dataclass(frozen=True)
class StructureOptions:
    """What a reconstruction must fulfil.

    Attributes:
        min_share, min_images: the fewest images that must be registered, as a share of all and as a number.
        max_dropped: rounds in which images that the pictures contradict are placed again or left out.
        limits: from where on a model counts as wrong.
        seed: of all RANSAC loops.
        object_only: whether nothing but the object was registered; decides the advice.
        leave_out: whether images may belong to another scene: those without matches with the others are left out, and `min_share`
            counts the rest, which must be at least `LEAST_COMMON_SHARE` of all.
        compare_pictures: whether the pictures of neighbours must show the same, however many points they share
            (`check_duplicate_structure`).
    """

    min_share: float = 0.8
    min_images: int = 8
    max_dropped: int = 6
    limits: ConsistencyLimits = field(default_factory=ConsistencyLimits)
    seed: int = 0
    object_only: bool = False
    leave_out: bool = False
    compare_pictures: bool = False

    @property
    def doubt_masks(self) -> bool:
        """Whether masks are more likely wrong than cameras: where a whole scene of the user's photos was registered."""
        return self.leave_out and not self.object_only


def add_matching_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all methods share that match features."""
    add_common_arguments(parser)
    defaults = StructureOptions()
    add_estimation_arguments(parser, defaults.min_share, defaults.min_images, defaults.seed)
    parser.add_argument("--focal-px", type=float, default=None, help="focal length if known; else EXIF or an estimate")


def read_structure_options(args: argparse.Namespace) -> StructureOptions:
    """The options that the command line gives."""
    return StructureOptions(
        min_share=args.min_share,
        min_images=args.min_images,
        seed=args.seed,
        object_only=args.scene in OBJECT_ONLY,
        leave_out=args.scene in PHOTO_SCENES,
    )


def reconstruct(
    database: Path,
    image_set: ImageSet,
    out: Path,
    options: StructureOptions,
    figures: dict[str, Any],
    stopwatch: Stopwatch,
    may_match: MayMatch | None = None,
    by_object: bool = False,
    start: pycolmap.Reconstruction | None = None,
    all_matches: Path | None = None,
) -> dict[str, Any]:
    """Estimate cameras from the verified matches of a database and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Args:
        database: COLMAP database with features and verified matches; what is written on the way lies beside it.
        figures: the record so far; completed in place.
        may_match: is asked about neighbours that share almost no points, see `check_duplicate_structure`.
        by_object: whether the object's features alone gave the matches, and the images have masks: then no ground tells sides apart.
        start: a model of these matches to begin with, where there is one, instead of mapping image by image.
        all_matches: a database with the matches that were left out of `database`, too; they may contradict the model.

    Returns:
        The record for registration.json.

    Raises:
        RegistrationFailed: too few images, an inconsistent model, or sides that look alike lie on each other.
    """
    count, scratch = len(image_set.images), database.parent
    if by_object:
        options = replace(options, limits=replace(options.limits, wrong_masks_share=WRONG_MASKS_OF_OBJECT))
    expected, apart = count, None
    if options.leave_out and not image_set.film:  # a film shows one scene: frames without matches are not foreign, but missing
        expected, apart = _count_connected(database, image_set, options, figures)
    if apart and not by_object:
        raise TooFewRegistered(apart, figures)
    needed = max(options.min_images, math.ceil(options.min_share * expected))
    mapper = make_mapping_options(min(needed, count), options.seed, many=count > MANY_IMAGES)
    model = start
    if start is None and not apart:  # images that lie apart have a model if they can be joined, and none otherwise
        model = map_incrementally(database, image_set.images[0].parent, scratch / "models", mapper)
    stopwatch.lap("map")
    if model is not None:
        model, report = _refine_and_verify(model, image_set, database, scratch, options, figures)
        stopwatch.lap("repair")
    registered, joined = (model.num_reg_images() if model else 0), False
    if by_object and registered < max(needed, math.ceil(options.min_share * count)):
        # Of an object alone, photos without matches are not foreign: they may show its other side.
        whole, figures["joining"] = merge_submodels(_map_submodels(database, image_set, options), image_set, scratch)
        stopwatch.lap("join")
        if whole is not None and whole.num_reg_images() >= max(needed, registered + 1):
            model, registered, joined = whole, whole.num_reg_images(), True
            # No matches hold the groups to each other: outlines and pictures do, and were asked.
            options = replace(options, limits=replace(options.limits, cut_matches=0))
            report = check_consistency(model, image_set, database, options.limits)
    if apart and not joined:
        raise TooFewRegistered(apart, figures)
    if model is None or registered < needed:
        way_out = "register the whole scene, with its ground" if options.object_only else "put the object on a strongly textured surface"
        raise TooFewRegistered(
            f"{registered} of {count} images registered, at least {needed} are needed; take more pictures with more overlap, or {way_out}",
            figures,
        )
    if report.reason is None:
        check = partial(check_consistency, image_set=image_set, database=database, limits=options.limits, doubt_masks=options.doubt_masks)
        improver = Improver(image_set, check, needed if by_object else count, figures)
        model, report = improver.refine_keypoints(model, report)
        stopwatch.lap("sharpen")
        held_loosely = by_object or model.compute_mean_observations_per_reg_image() < LOOSE_OBSERVATIONS
        if image_set.masks and held_loosely:
            model, report = improver.adjust_by_silhouettes(model, report)
            stopwatch.lap("outlines")
    name_missing(figures, image_set, {image.name for image in model.images.values() if image.has_pose})
    if report.wrong_masks:
        shown = ", ".join(image_set.shown[name] for name in report.wrong_masks)
        figures["warnings"] = [
            *figures.get("warnings", []),
            f"the masks of {len(report.wrong_masks)} of {count} photos contradict those of the others: {shown}",
        ]
    pinhole_model = undistort(model, image_set, out)
    stopwatch.lap("undistort")
    figures |= describe_lenses(model)
    figures |= describe_model(pinhole_model) | {"consistency": report.figures()}
    stopwatch.stop()
    if report.reason:
        raise RegistrationFailed(report.reason, figures, pinhole_model)
    if not joined:
        check_loop_gap(model, pinhole_model, all_matches or database, options.seed, figures)
    record = (
        figures
        if joined
        else check_duplicate_structure(
            pinhole_model, figures, may_match, by_object, None if by_object else out / "images", options.compare_pictures
        )
    )
    if by_object:
        views = read_views(out)[0]
        check_photometric_consistency(views, record, pinhole_model)
        check_wide_baseline(views, record, pinhole_model)
    return record


def _map_submodels(database: Path, image_set: ImageSet, options: StructureOptions) -> list[pycolmap.Reconstruction]:
    mapper = make_mapping_options(LEAST_IMAGES, options.seed)
    return map_submodels(database, image_set.images[0].parent, database.parent / "groups", mapper)


def _count_connected(database: Path, image_set: ImageSet, options: StructureOptions, figures: dict[str, Any]) -> tuple[int, str | None]:
    """How many images show one scene; and why no scene can be told, where these are too few of all."""
    groups = find_components(database)
    count, common = len(image_set.images), len(groups[0])
    apart = None
    if common < max(options.min_images, math.ceil(LEAST_COMMON_SHARE * count)) and any(len(names) > 1 for names in groups[1:]):
        found = describe_components(groups, image_set.shown)
        apart = (
            f"the {count} photos do not show one scene, or do not overlap: {found} fit together; give the photos of one object that was"
            " not moved, or take more pictures in between, on a ground with plenty of print"
        )
    figures["foreign"] = sorted(set(image_set.names) - set(groups[0]))
    return max(common, math.ceil(LEAST_COMMON_SHARE * count)), apart


def _refine_and_verify(
    model: pycolmap.Reconstruction, image_set: ImageSet, database: Path, scratch: Path, options: StructureOptions, figures: dict[str, Any]
) -> tuple[pycolmap.Reconstruction, ConsistencyReport]:
    """Refine, place suspicious images again, and leave out those that the pictures contradict even then, or hold unsurely."""
    images = image_set.images[0].parent
    model, again = repair(model, database, images, scratch, options.seed)
    report = check_consistency(model, image_set, database, options.limits, options.doubt_masks)
    dropped: list[str] = []
    for _ in range(options.max_dropped):
        if report.reason is None or not report.culprits or model.num_reg_images() - len(report.culprits) < options.min_images:
            break
        names = list(report.culprits)
        if set(names) <= set(again):
            dropped += names
            model = remove_images(model, names)
        else:
            again += names
            model = register_again(model, names, database, images, scratch, options.seed)
        refine_robustly(model)
        report = check_consistency(model, image_set, database, options.limits, options.doubt_masks)
    if report.reason is None and image_set.masks is None and (unsure := find_unsure(model, report.evidence)):
        dropped += unsure
        model = remove_images(model, unsure)
        refine_robustly(model)
        report = check_consistency(model, image_set, database, options.limits, options.doubt_masks)
    figures |= {"placed_again": again, "left_out": dropped}
    return model, report
