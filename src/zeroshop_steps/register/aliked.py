"""Register by learned features: ALIKED's features of the object, enlarged, matched by LightGlue; then COLMAP's mapper and its checks.

They match views of an object alone, on a plain ground or without one, where SIFT finds too little. Masks are needed: on whole photos
of plain tables, wrong cameras passed all checks. Views of sides that look alike match, too, but LightGlue is less sure of these
matches: pairs count by their sure matches.
"""

import argparse
import functools
import shutil
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pycolmap

from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.networks.aliked import (
    FOLDER,
    AlikedMatcher,
    Crop,
    FeatureMatcher,
    cut_out,
    find_weights,
    load_extractor,
    load_matcher,
)
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.features.sift import RIM_SHARE
from zeroshop_steps.register.matching.network_matches import PairMatches, write_matches
from zeroshop_steps.register.matching.pair_selection import choose_alike_pairs
from zeroshop_steps.register.matching.rotation_consistency import delete_contradicting_pairs
from zeroshop_steps.register.pipeline import StructureOptions, add_matching_arguments, read_structure_options, reconstruct
from zeroshop_steps.register.registration import add_network_arguments, add_options, read_options, write_registration
from zeroshop_steps.register.scene.image_set import ImageSet, read_image_set, read_masks
from zeroshop_steps.register.scene.record import Record, RegistrationFailed, move_contents
from zeroshop_steps.register.verification.duplicate_structure import MayMatch
from zeroshop_steps.register.verification.pair_appearance import delete_inconsistent_pairs
from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import scratch_directory
from zeroshop_steps.runtime.progress import track

CACHED = Cached(inputs=("capture/images", "capture/masks", "capture/cameras.json", "weights"), ignored=("threads", "device"))
MARGIN = 0.08  # around the object, as a share of its size in the image
LARGEST_SCALE = 4.0  # beyond it, enlarging shows nothing more
Match = Callable[[int, int], tuple[np.ndarray, np.ndarray]]
"""The matches of two images and how sure they are, as `FeatureMatcher.match` gives them."""
AGAIN = 2  # times the fewest sure matches of a pair: images from nearly one direction have many more


@dataclass(frozen=True)
class AlikedOptions:
    """Parameters of the method.

    Attributes:
        side_px: the object is resized to this length of its longer side.
        max_keypoints: of each image.
        threshold: of the network's score of a keypoint.
        partners: images that each image is matched with: those that share most features that look alike.
        sure_score, sure_matches: a pair counts where so many matches have this score or a higher one.
        min_score: in a pair that counts, of each match.
        focal_px: known focal length; None reads EXIF, else estimates.
        structure: of the reconstruction.
    """

    side_px: int = 640
    max_keypoints: int = 768
    threshold: float = 0.005
    partners: int = 7
    sure_score: float = 0.85
    sure_matches: int = 15
    min_score: float = 0.4
    focal_px: float | None = None
    structure: StructureOptions = field(default_factory=StructureOptions)


class Prepare(Protocol):
    """What finds the features of crops; those of the numbers in `turned` are described in all quarter turns."""

    def __call__(self, crops: list[Crop], turned: Collection[int] = ()) -> AlikedMatcher: ...


METHOD = {
    "title": "ALIKED",
    "rank": 2,
    "weights": ("aliked/aliked-n16.pth", "aliked/aliked_lightglue.pth"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_matching_arguments(parser)
    add_own_arguments(parser)


def add_own_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that this method alone has."""
    texts = {"side_px": "length of the network's pictures", "max_keypoints": "of each image", "partners": "images to match each with"}
    add_options(parser, AlikedOptions(), **texts)
    add_network_arguments(parser, WEIGHTS_FOLDER / FOLDER, "folder of the networks' weights")


def read_aliked_options(args: argparse.Namespace) -> AlikedOptions:
    """The options that the command line gives."""
    return read_options(AlikedOptions, args, structure=read_structure_options(args))


def make_matcher(args: argparse.Namespace, options: AlikedOptions) -> Prepare:
    """What finds and matches the features of crops, with the weights and on the device that the command line names.

    Raises:
        StepError: the weights are not there or wrong, or there is no such device.
    """
    import torch

    from zeroshop_steps.networks.devices import choose_device

    device = torch.device(choose_device(args.device))
    extractor, matcher = find_weights(args.weights)

    def prepare(crops: list[Crop], turned: Collection[int] = ()) -> AlikedMatcher:
        torch.set_num_threads(args.threads)
        networks = load_extractor(extractor), load_matcher(matcher)
        return AlikedMatcher(*networks, crops, device, options.max_keypoints, options.threshold, turned)

    return prepare


def run(args: argparse.Namespace) -> None:
    """Write the cameras folder."""
    options = read_aliked_options(args)
    prepare, image_set = make_matcher(args, options), read_image_set(args.capture)
    write_registration(args.out, lambda folder: register(image_set, folder, options, prepare))


def register(image_set: ImageSet, out: Path, options: AlikedOptions, prepare: Callable[[list[Crop]], FeatureMatcher]) -> dict[str, Any]:
    """Estimate cameras and write images/, sparse/ and, where there are masks, masks/ to `out`; returns the record.

    Raises:
        RegistrationFailed: nothing matches, too few images, or an inconsistent model.
        StepError: there are no masks, or the networks cannot run.
    """
    import torch

    if image_set.masks is None:
        raise StepError(
            f"{image_set.images[0].parent.parent} has no masks, and whole photos of plain tables gave wrong cameras by learned"
            " features, which nothing showed to be wrong; give masks, or use the registration colmap"
        )
    record = Record.begin("aliked", image_set, options, pycolmap, torch)
    matcher = prepare(cut_crops(image_set, options.side_px))
    record = record.add(median_features=float(np.median([len(points) for points in matcher.keypoints])))
    record.stopwatch.lap("extract")
    matches = match_images(matcher, options)
    record.stopwatch.lap("match")
    with scratch_directory(out, "aliked") as scratch:
        database = scratch / "database.db"
        seed = options.structure.seed
        kept = write_matches(database, image_set, matcher.keypoints, matches, 2, seed, options.focal_px, distorted=False)
        record = record.add(**kept)
        if not kept["matches"]:
            raise record.fail("no two images share enough features that surely match; take more pictures with more overlap")
        number = {path.stem: index for index, path in enumerate(image_set.images)}

        @functools.cache
        def may_match(one: str, other: str) -> bool:
            _, scores = matcher.match(number[one], number[other])
            return bool((scores >= options.sure_score).sum() >= AGAIN * options.sure_matches)

        try:
            return _reconstruct(database, image_set, out, options, record, may_match)
        except RegistrationFailed as failure:
            unlike = delete_inconsistent_pairs(database, image_set)
            record.stopwatch.lap("compare")
            if not unlike:
                raise
            warn(f"{failure}; trying again without the {len(unlike)} pairs of images that match but do not show the same")
            try:
                record = record.add(unlike_pairs=unlike, first_reason=str(failure))
                return _reconstruct(database, image_set, out, options, record, may_match)
            except RegistrationFailed:
                raise failure from None


def _reconstruct(
    database: Path,
    image_set: ImageSet,
    out: Path,
    options: AlikedOptions,
    record: Record,
    may_match: MayMatch,
) -> dict[str, Any]:
    """Cameras from a copy of the database, without the pairs whose rotations contradict the others."""

    with scratch_directory(out, "cameras") as folder, scratch_directory(out, "model") as scratch:
        copy = Path(shutil.copy(database, scratch / database.name))
        begun = record.add(contradicting_pairs=delete_contradicting_pairs(copy, options.structure.seed))
        record.stopwatch.lap("verify")
        done = reconstruct(copy, image_set, folder, options.structure, begun, may_match, by_object=True, all_matches=database)
        move_contents(folder, out)
    return dict(done.entries)


def cut_crops(image_set: ImageSet, side_px: int) -> list[Crop]:
    """What the network sees of each image: the object."""
    masks = read_masks(image_set)
    crops = []
    for path, size_px in zip(image_set.images, image_set.sizes_px, strict=True):
        rim_px = max(1, round(max(size_px) * RIM_SHARE))
        crops.append(cut_out(read_image(path), masks[path.name], side_px, MARGIN, LARGEST_SCALE, rim_px))
    return crops


def match_images(matcher: FeatureMatcher, options: AlikedOptions) -> PairMatches:
    """Match each image with its partners; the good matches of the pairs that count."""
    return match_pairs(matcher.match, choose_alike_pairs(matcher.similarities(), options.partners), options)


def match_pairs(match: Match, pairs: list[tuple[int, int]], options: AlikedOptions) -> PairMatches:
    """The good matches of the pairs that count: those with enough sure ones."""
    found = {}
    for first, second in track(pairs, "matching pairs", len(pairs)):
        numbers, scores = match(first, second)
        if (scores >= options.sure_score).sum() >= options.sure_matches:
            good = numbers[scores >= options.min_score]
            found[first, second] = (good[:, 0], good[:, 1])
    return found
