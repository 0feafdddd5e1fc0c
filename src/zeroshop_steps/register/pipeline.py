"""From a database of matches to cameras: map, refine, check against masks and image pairs, undistort. Shared by methods that match."""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import pycolmap

from zeroshop_steps.register.final_checks import FinalChecks
from zeroshop_steps.register.final_refinement import Hypothesis, Improver
from zeroshop_steps.register.mapping.mapper import make_mapping_options, map_incrementally, map_submodels
from zeroshop_steps.register.mapping.reregistration import refine_robustly, register_again, remove_images, repair
from zeroshop_steps.register.matching.view_graph import describe_components, find_components
from zeroshop_steps.register.registration import add_common_arguments, add_estimation_arguments, read_options
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import (
    OBJECT_ONLY,
    PHOTO_SCENES,
    Record,
    TooFewRegistered,
    describe_model,
    find_missing,
)
from zeroshop_steps.register.scene.undistortion import undistort
from zeroshop_steps.register.submodels.merge import LEAST_IMAGES, merge_submodels
from zeroshop_steps.register.verification.consistency import ConsistencyLimits, ConsistencyReport, check_consistency, find_unsure
from zeroshop_steps.register.verification.duplicate_structure import MayMatch
from zeroshop_steps.register.verification.verdict import verify

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
    """

    min_share: float = 0.8
    min_images: int = 8
    max_dropped: int = 6
    limits: ConsistencyLimits = field(default_factory=ConsistencyLimits)
    seed: int = 0
    object_only: bool = False
    leave_out: bool = False

    @property
    def doubt_masks(self) -> bool:
        """Whether masks are more likely wrong than cameras: where a whole scene of the user's photos was registered."""
        return self.leave_out and not self.object_only


def add_matching_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all methods share that match features."""
    add_common_arguments(parser)
    add_estimation_arguments(parser, StructureOptions())
    parser.add_argument("--focal-px", type=float, default=None, help="focal length if known; else EXIF or an estimate")


def read_structure_options(args: argparse.Namespace) -> StructureOptions:
    """The options that the command line gives."""
    whose = {"object_only": args.scene in OBJECT_ONLY, "leave_out": args.scene in PHOTO_SCENES}
    return read_options(StructureOptions, args, limits=read_options(ConsistencyLimits, args), **whose)


def reconstruct(
    database: Path,
    image_set: ImageSet,
    out: Path,
    options: StructureOptions,
    record: Record,
    may_match: MayMatch | None = None,
    by_object: bool = False,
    start: pycolmap.Reconstruction | None = None,
    all_matches: Path | None = None,
) -> Record:
    """Estimate cameras from the verified matches of a database and write images/, sparse/ and, where there are masks, masks/ to `out`.

    Args:
        database: COLMAP database with features and verified matches; what is written on the way lies beside it.
        record: what is known so far.
        may_match: is asked about neighbours that share almost no points, see `check_duplicate_structure`.
        by_object: whether the object's features alone gave the matches, and the images have masks: then no ground tells sides apart.
        start: a model of these matches to begin with, where there is one, instead of mapping image by image.
        all_matches: a database with the matches that were left out of `database`, too; they may contradict the model.

    Returns:
        The completed record.

    Raises:
        RegistrationFailed: too few images, an inconsistent model, or distinct sides were merged (duplicate structure).
    """
    count, scratch = len(image_set.images), database.parent
    if by_object:
        options = replace(options, limits=replace(options.limits, wrong_masks_share=WRONG_MASKS_OF_OBJECT))
    expected, apart = count, None
    if options.leave_out and not image_set.film:  # a film shows one scene: frames without matches are not foreign, but missing
        expected, foreign, apart = _find_connected(database, image_set, options)
        record = record.add(foreign=foreign)
    if apart and not by_object:
        raise record.fail(apart, kind=TooFewRegistered)
    needed = max(options.min_images, math.ceil(options.min_share * expected))
    model = start
    if start is None and not apart:  # images that lie apart have a model if they can be joined, and none otherwise
        mapper = make_mapping_options(min(needed, count), options.seed)
        model = map_incrementally(database, image_set.images[0].parent, scratch / "models", mapper)
    record.stopwatch.lap("map")
    hypothesis = None
    if model is not None:
        hypothesis = refine_and_repair(model, image_set, database, scratch, options)
        record = record.add(placed_again=list(hypothesis.placed_again), left_out=list(hypothesis.left_out))
        record.stopwatch.lap("repair")
    if by_object and (hypothesis.registered if hypothesis else 0) < max(needed, math.ceil(options.min_share * count)):
        # Of an object alone, photos without matches are not foreign: they may show its other side.
        mapper = make_mapping_options(LEAST_IMAGES, options.seed)
        submodels = map_submodels(database, image_set.images[0].parent, scratch / "groups", mapper)
        whole, tried = merge_submodels(submodels, image_set, scratch)
        record = record.add(joining=tried)
        record.stopwatch.lap("join")
        if whole is not None and whole.num_reg_images() >= max(needed, (hypothesis.registered if hypothesis else 0) + 1):
            # No matches hold the submodels to each other: outlines and pictures do, and were asked.
            options = replace(options, limits=replace(options.limits, cut_matches=0))
            left_out = hypothesis.left_out if hypothesis else ()
            report = check_consistency(whole, image_set, database, options.limits)
            hypothesis = Hypothesis(whole, report, left_out=left_out, merged=True)
    if apart and not (hypothesis and hypothesis.merged):
        raise record.fail(apart, kind=TooFewRegistered)
    if hypothesis is None or hypothesis.registered < needed:
        way_out = "register the whole scene, with its ground" if options.object_only else "put the object on a strongly textured surface"
        raise record.fail(
            f"{hypothesis.registered if hypothesis else 0} of {count} images registered, at least {needed} are needed; take more pictures"
            f" with more overlap, or {way_out}",
            kind=TooFewRegistered,
        )
    if not hypothesis.report.is_doubtful:
        check = partial(check_consistency, image_set=image_set, database=database, limits=options.limits, doubt_masks=options.doubt_masks)
        improver = Improver(image_set, check, needed if by_object else count)
        hypothesis, record = improve(improver, hypothesis, by_object, record)
    asked = FinalChecks(out, all_matches or database, may_match, by_object, options.seed)
    return write_checked(hypothesis, image_set, asked, record)


def improve(improver: Improver, hypothesis: Hypothesis, by_object: bool, record: Record) -> tuple[Hypothesis, Record]:
    """The model refined by pictures, and by silhouettes where points hold it loosely."""
    left_out = hypothesis.left_out
    hypothesis, found = improver.refine_keypoints(hypothesis)
    record = record.add(**found)
    record.stopwatch.lap("sharpen")
    held_loosely = by_object or hypothesis.model.compute_mean_observations_per_reg_image() < LOOSE_OBSERVATIONS
    if improver.image_set.masks and held_loosely:
        hypothesis, found = improver.adjust_by_silhouettes(hypothesis, bool(record.entries["sharpened"].get("points")))
        record = record.add(**found)
        record.stopwatch.lap("outlines")
    return hypothesis, record if hypothesis.left_out == left_out else record.add(left_out=list(hypothesis.left_out))


def write_checked(hypothesis: Hypothesis, image_set: ImageSet, asked: FinalChecks, record: Record) -> Record:
    """Write the undistorted model into the folder of the checks, and complete the record.

    Raises:
        RegistrationFailed: the checks refuse the model.
    """
    model, report = hypothesis.model, hypothesis.report
    record = record.judge(find_missing(image_set, {image.name for image in model.images.values() if image.has_pose}))
    if report.wrong_masks:
        shown = ", ".join(image_set.shown[name] for name in report.wrong_masks)
        record = record.warn(
            f"the masks of {len(report.wrong_masks)} of {len(image_set.images)} photos contradict those of the others: {shown}"
        )
    pinhole_model, lenses = undistort(model, image_set, asked.folder)
    record.stopwatch.lap("undistort")
    record = record.judge(lenses).add(**describe_model(pinhole_model))
    record.stopwatch.stop()
    return verify(record, asked.about(hypothesis, pinhole_model), pinhole_model, report.max_wrong_probability)


def _find_connected(database: Path, image_set: ImageSet, options: StructureOptions) -> tuple[int, list[str], str | None]:
    """How many images matches tie to one scene, the names of the others, and why no scene can be told, where these are too many."""
    groups = find_components(database)
    count, common = len(image_set.images), len(groups[0])
    apart = None
    if common < max(options.min_images, math.ceil(LEAST_COMMON_SHARE * count)) and any(len(names) > 1 for names in groups[1:]):
        found = describe_components(groups, image_set.shown)
        apart = (
            f"the {count} photos do not show one scene, or do not overlap: {found} fit together; give the photos of one object that was"
            " not moved, or take more pictures in between, on a ground with plenty of print"
        )
    foreign = sorted(set(image_set.names) - set(groups[0]))
    return max(common, math.ceil(LEAST_COMMON_SHARE * count)), foreign, apart


def refine_and_repair(
    model: pycolmap.Reconstruction, image_set: ImageSet, database: Path, scratch: Path, options: StructureOptions
) -> Hypothesis:
    """Refine, place suspicious images again, and leave out those that the pictures contradict even then, or hold unsurely."""
    images = image_set.images[0].parent
    model, again = repair(model, database, images, scratch, options.seed)
    check = partial(check_consistency, image_set=image_set, database=database, limits=options.limits, doubt_masks=options.doubt_masks)
    place = partial(register_again, database=database, images=images, scratch=scratch, seed=options.seed)
    found = leave_out_culprits(Hypothesis(model, check(model), tuple(again)), options, place, refine_robustly, check)
    if not found.report.is_doubtful and image_set.masks is None and (unsure := find_unsure(found.model, found.report.evidence)):
        model = remove_images(found.model, unsure)
        refine_robustly(model)
        found = replace(found, model=model, report=check(model), left_out=(*found.left_out, *unsure))
    return found


def leave_out_culprits(
    found: Hypothesis,
    options: StructureOptions,
    place: Callable[[pycolmap.Reconstruction, list[str]], pycolmap.Reconstruction],
    refine: Callable[[pycolmap.Reconstruction], None],
    check: Callable[[pycolmap.Reconstruction], ConsistencyReport],
) -> Hypothesis:
    """The model whose images that a check blames were placed again, and left out where they are blamed even then.

    Args:
        found: the model, its report, and the images that were placed again before.
        options: how often, and how many images must stay.
        place: a copy of a model with some images placed anew.
        refine: adjusts a model in place.
        check: of a model.
    """
    for _ in range(options.max_dropped):
        model, names = found.model, found.report.culprits
        if not names or found.registered - len(names) < options.min_images:
            break
        if set(names) <= set(found.placed_again):
            model, left_out, again = remove_images(model, list(names)), (*found.left_out, *names), found.placed_again
        else:
            model, left_out, again = place(model, list(names)), found.left_out, (*found.placed_again, *names)
        refine(model)
        found = Hypothesis(model, check(model), again, left_out)
    return found
