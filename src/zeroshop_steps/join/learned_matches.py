"""Learned features of the object in all passes, for things with little print: ALIKED's, enlarged, matched by LightGlue.

These networks match views of like roll alone, but a thing that stands on its head shows itself turned. So the features of later passes are
described in all quarter turns of their pictures, and each pair of views across passes is matched in the turn in which they are most alike.
"""

import argparse
from pathlib import Path

import numpy as np

from zeroshop_steps.join.object_matches import choose_in_passes, read_cameras
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.networks.aliked import FOLDER, AlikedMatcher, has_weights
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.aliked import AlikedOptions, Prepare, cut_crops, make_matcher, match_pairs
from zeroshop_steps.register.matching.network_matches import write_matches
from zeroshop_steps.register.scene.image_set import ImageSet

PARTNERS = 6  # of each image in its own pass, and as many in each that it is compared with
OPTIONS = AlikedOptions()


def load_networks(args: argparse.Namespace) -> Prepare | None:
    """What finds and matches features, as the command line says; None where the published weights are not there.

    Raises:
        StepError: the user's folder lacks them, they are damaged, or there is no such device.
    """
    if args.weights == WEIGHTS_FOLDER / FOLDER and not has_weights(args.weights):
        return None
    return make_matcher(args, OPTIONS)


def match_by_networks(image_set: ImageSet, passes: list[Pass], scratch: Path, prepare: Prepare, seed: int) -> Path:
    """A database of learned features in all images, matched within passes, and between the first and the later ones; returns its file."""
    counts = [len(one.images) for one in passes]
    matcher = prepare(cut_crops(image_set, OPTIONS.side_px), range(counts[0], sum(counts)))
    scratch.mkdir()
    database = scratch / "object.db"
    pairs, quarters = choose_pairs(matcher, counts)
    found = match_pairs(lambda first, second: matcher.match(first, second, quarters.get((first, second), 0)), pairs, OPTIONS)
    write_matches(database, image_set, matcher.keypoints, found, 2, seed, known_cameras=read_cameras(passes))
    return database


def choose_pairs(matcher: AlikedMatcher, counts: list[int]) -> tuple[list[tuple[int, int]], dict[tuple[int, int], int]]:
    """Pairs (i, j), i < j, of the images that are most alike, and by how many quarters the second picture of some is turned.

    Args:
        matcher: with the features of the images, pass by pass.
        counts: of the images of each pass.
    """
    alike = matcher.similarities()
    number = np.repeat(np.arange(len(counts)), counts)
    first, later = np.flatnonzero(number == 0), np.flatnonzero(number > 0)
    # Later passes are not compared with each other.
    alike[(number[:, None] != number) & (number[:, None] > 0) & (number > 0)] = -np.inf
    quarters = {}
    for one in first.tolist():
        for other in later.tolist():
            quarters[one, other], alike[one, other] = matcher.find_quarter(one, other)
            alike[other, one] = alike[one, other]
    return choose_in_passes(alike, counts, PARTNERS), quarters
