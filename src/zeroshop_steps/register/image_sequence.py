"""Photos in the order in which they were taken: sides that look alike do not mislead those that follow one another.

A can that has its print twice looks the same after half a turn, and its photos may be folded onto half of the circle. But photos that
follow one another show the same side: somewhere their matches contradict such a model. By them alone the circle unfolds; then the matches
of other pairs count that agree with it.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

from zeroshop_steps.register.mapping.mapper import map_incrementally
from zeroshop_steps.register.scene.database import LEAST_TIES, delete_pair, read_matches
from zeroshop_steps.register.scene.record import Evidence, Finding
from zeroshop_steps.register.verification.epipolar_support import EpipolarSupport, count_epipolar_support

IN_ORDER_SHARE, NEXT_SHARE = 0.9, 0.25
"""Images are in order if so many of the steps from one to the next are from an image to one of this share of all that match it best."""
AGREEING_SHARE = 0.7  # of the matches of a pair that cameras explain, for the pair to agree with them
REACHES = 1, 2, 3  # steps between images that are mapped at first: few may hold them together, many may be as far apart as equal sides
CONTRADICTED_SHARE = 0.5
"""Of the matches of two images that follow one another, beyond what is usual, for cameras to be as likely wrong as right. Folded models of
rendered objects had 0.59 to 0.91, right ones up to 0.19, and a plush sitting on folds of cloth 0.44."""


def are_in_order(database: Path) -> bool:
    """Whether the names of a database's images give their order, by its verified matches."""
    with pycolmap.Database.open(database) as opened:
        images = sorted(opened.read_all_images(), key=lambda image: image.name)
        row = {image.image_id: index for index, image in enumerate(images)}
        matches = np.zeros((len(images),) * 2, int)
        for pair, found in read_matches(opened):
            one, other = (row[image_id] for image_id in pair)
            matches[one, other] = matches[other, one] = len(found)
    return _follow(matches)


def _follow(matches: np.ndarray) -> bool:
    """Whether images follow one another, by the (N, N) numbers of their matches."""
    best = max(round(NEXT_SHARE * len(matches)), 2)
    ranks = (matches[:, :, None] < matches[:, None, :]).sum(2)  # of each image, for each: how many match it better
    near = (np.minimum(ranks.diagonal(1), ranks.diagonal(-1)) < best) & (matches.diagonal(1) >= LEAST_TIES)
    return len(matches) > 2 * best and bool(near.mean() >= IN_ORDER_SHARE)


def check_order(found: EpipolarSupport) -> Evidence:
    """Whether a model contradicts images that follow one another; without an order, there is nothing to say.

    Args:
        found: how the verified matches of all pairs support the model, also of those that had no part in it.
    """
    matches = found.supporting + found.contradicting
    if not _follow(matches):
        return Evidence()
    total, contradicting = matches.diagonal(1), found.contradicting.diagonal(1)
    shares = contradicting / np.maximum(total, 1)  # of verified pairs, which have 15 matches at least
    usual = contradicting.sum() / max(total.sum(), 1)  # where print repeats itself, chance matches contradict right cameras, too
    worst = int(shares.argmax())
    names = " and ".join(found.names[worst : worst + 2])
    said = (
        f"{shares[worst]:.0%} of the matches of {names}, which follow one another, contradict the cameras (of all such images, {usual:.0%})"
    )
    return Evidence(findings=(Finding("order", float(max(shares[worst] - usual, 0.0) / CONTRADICTED_SHARE), said),))


def keep_sequence(database: Path, copy: Path, images: Path, options: pycolmap.IncrementalPipelineOptions) -> list[tuple[str, str]]:
    """Write a copy of a database without the pairs that contradict those of images that follow one another.

    Args:
        database: with verified matches of images whose names give their order.
        copy: to write; models are written beside it.
        images: the folder of the images.
        options: of the mapper.

    Returns:
        The names of the images of each pair that is left.
    """
    order = _read_order(database)
    best: EpipolarSupport | None = None
    for reach in REACHES:
        shutil.copy(database, copy)
        near = _delete_pairs(copy, _find_near(order, reach))
        model = map_incrementally(copy, images, copy.parent / f"sequence_{reach}", options)
        if model is None:
            continue
        found = count_epipolar_support(model, database)
        if any(finding.strength >= 1 for finding in check_order(found).findings):
            continue
        if best is None or len(found.names) > len(best.names):
            best = found
        if len(best.names) == len(order):
            break
    if best is None:
        return near
    matches = best.supporting + best.contradicting
    agree = (matches >= LEAST_TIES) & (best.supporting >= AGREEING_SHARE * matches)
    agreeing = {frozenset((best.names[one], best.names[other])) for one, other in np.argwhere(agree)}
    shutil.copy(database, copy)
    return _delete_pairs(copy, agreeing | _find_near(order, REACHES[0]))


def _read_order(database: Path) -> list[str]:
    with pycolmap.Database.open(database) as opened:
        return sorted(image.name for image in opened.read_all_images())


def _find_near(order: Sequence[str], reach: int) -> set[frozenset[str]]:
    """The names of the images of each pair that lie so few steps apart."""
    return {frozenset(pair) for step in range(1, reach + 1) for pair in zip(order, order[step:], strict=False)}


def _delete_pairs(database: Path, kept: set[frozenset[str]]) -> list[tuple[str, str]]:
    """Delete all pairs but those given by the names of their images; the names of what is left."""
    left = []
    with pycolmap.Database.open(database) as opened:
        names = {image.image_id: image.name for image in opened.read_all_images()}
        for pair, _ in read_matches(opened, verified=False):
            one, other = (names[image_id] for image_id in pair)
            if frozenset((one, other)) in kept:
                left.append((one, other))
            else:
                delete_pair(opened, *pair)
    return left
