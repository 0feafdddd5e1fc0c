"""Learned features of the object in all passes, for things with little print: ALIKED's, enlarged, matched by LightGlue.

These networks match views of like roll alone, but a thing that stands on its head shows itself turned. So the features of later passes are
described in all quarter turns of their pictures, and each pair of views across passes is matched in the turn in which they are most alike.
"""

from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import torch

from zeroshop_steps.join.object_matches import read_cameras
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.networks.aliked import EXTRACTOR, FOLDER, MATCHER, AlikedMatcher, Crop, find_weights, load_extractor, load_matcher
from zeroshop_steps.networks.devices import choose_device
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.aliked import AlikedOptions, cut_crops
from zeroshop_steps.register.image_set import ImageSet
from zeroshop_steps.register.match_database import PairMatches, write_matches
from zeroshop_steps.runtime.progress import track

PARTNERS = 6  # of each image in its own pass, and as many in each that it is compared with
OPTIONS = AlikedOptions()

Prepare = Callable[[list[Crop], Collection[int]], AlikedMatcher]
"""Finds the features of crops; those of the given numbers are described in all quarter turns."""


def load_networks(weights: Path, device: str, threads: int) -> Prepare | None:
    """What finds and matches features; None where the published weights are not there.

    Args:
        weights: folder of the published weights, or the user's own, which must hold them.
        device: see `DEVICES`.
        threads: worker threads.

    Raises:
        StepError: the user's folder lacks them, they are damaged, or there is no such device.
    """
    if weights == WEIGHTS_FOLDER / FOLDER and not all((weights / name).is_file() for name in (EXTRACTOR, MATCHER)):
        return None
    files, chosen = find_weights(weights), torch.device(choose_device(device))

    def prepare(crops: list[Crop], turned: Collection[int]) -> AlikedMatcher:
        torch.set_num_threads(threads)
        extractor, matcher = load_extractor(files[0]), load_matcher(files[1])
        return AlikedMatcher(extractor, matcher, crops, chosen, OPTIONS.max_keypoints, OPTIONS.threshold, turned)

    return prepare


def match_by_networks(image_set: ImageSet, passes: list[Pass], scratch: Path, prepare: Prepare, seed: int) -> Path:
    """A database of learned features in all images, matched within passes, and between the first and the later ones; returns its file."""
    counts = [len(one.images) for one in passes]
    matcher = prepare(cut_crops(image_set, OPTIONS.side_px), range(counts[0], sum(counts)))
    scratch.mkdir()
    database = scratch / "object.db"
    found = match_pairs(matcher, *choose_pairs(matcher, counts))
    write_matches(database, image_set, matcher.keypoints, found, 2, seed, known_cameras=read_cameras(passes))
    return database


def choose_pairs(matcher: AlikedMatcher, counts: list[int]) -> tuple[list[tuple[int, int]], dict[tuple[int, int], int]]:
    """Pairs (i, j), i < j, of the images that are most alike, and by how many quarters the second picture of some is turned.

    Args:
        matcher: with the features of the images, pass by pass.
        counts: of the images of each pass.
    """
    alike = matcher.similarities()
    groups = np.split(np.arange(sum(counts)), np.cumsum(counts)[:-1])
    quarters = {}
    for one in groups[0]:
        for other in np.concatenate([np.zeros(0, int), *groups[1:]]):
            quarters[int(one), int(other)], alike[one, other] = matcher.find_quarter(int(one), int(other))
            alike[other, one] = alike[one, other]
    pairs = set()
    for number, group in enumerate(groups):
        for image in group:
            for partners in [group, *(groups[1:] if number == 0 else groups[:1])]:
                others = partners[partners != image]
                for other in others[np.argsort(-alike[image, others], kind="stable")[:PARTNERS]]:
                    pairs.add((min(int(image), int(other)), max(int(image), int(other))))
    return sorted(pairs), quarters


def match_pairs(matcher: AlikedMatcher, pairs: list[tuple[int, int]], quarters: dict[tuple[int, int], int]) -> PairMatches:
    """The good matches of the pairs that count: those with enough sure ones."""
    found = {}
    for pair in track(pairs, "matching pairs", len(pairs)):
        numbers, scores = matcher.match(*pair, quarters.get(pair, 0))
        if (scores >= OPTIONS.sure_score).sum() >= OPTIONS.sure_matches:
            good = numbers[scores >= OPTIONS.min_score]
            found[pair] = (good[:, 0], good[:, 1])
    return found
