"""Take more frames of a film where two that follow each other share too little to be registered together.

On a ground with print, a few frames from all around are enough. On a plain table they share hardly any features, and cameras are found
bent, folded or not at all: the film has the views in between, so they are taken where they are needed.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.capture.frame_quality import bound_to_grey
from zeroshop_steps.geometry.imaging.image_overlap import RATIO, find_root_sift

SHARED_FEATURES = 60
"""Verified matches of two frames that follow each other. On plain tables, frames with 10 to 40 gave cameras that were 20 mm off or folded,
frames in between with 50 to 100 gave them within 3 mm; on print, most have several hundred."""
SIDE_PX = 960  # longer side of the copies that are compared
FEATURES, CONTRAST = 3000, 0.01  # of SIFT; plain tables have few and weak ones
EPIPOLAR_PX = 1.5  # of matches to the epipolar line, in the copies
LEAST_MATCHES = 8  # for a fundamental matrix

Frames = Callable[[Iterable[int]], Iterable[tuple[int, np.ndarray]]]


@dataclass(frozen=True)
class Features:
    """Features of a frame.

    Attributes:
        points_px: (K, 2) float32 in the small copy.
        descriptors: (K, 128) float32 unit descriptors.
        size_px: (width, height) of the small copy.
    """

    points_px: np.ndarray
    descriptors: np.ndarray
    size_px: tuple[int, int]


def bridge_gaps(frames: Frames, chosen: list[int], between: Callable[[int, int], int | None], most: int) -> list[int]:
    """Numbers of the frames, with more of them where two neighbours share too little.

    Args:
        frames: reads frames by their numbers, one after the other: number and (H, W, 3) uint8 RGB.
        chosen: numbers of the first choice, in order.
        between: the best frame between two, if there is one that shows something new.
        most: frames in all; the weakest gaps are bridged first.
    """
    features: dict[int, Features] = {}
    shared: dict[tuple[int, int], int] = {}
    closed: set[tuple[int, int]] = set()  # gaps that hold no frame that shows something new
    while len(chosen) < most:
        missing = [number for number in chosen if number not in features]
        features |= {number: find_features(frame) for number, frame in frames(missing)}
        gaps = [gap for gap in zip(chosen, chosen[1:], strict=False) if gap not in closed]
        shared |= {gap: count_shared(features[gap[0]], features[gap[1]]) for gap in gaps if gap not in shared}
        weak = sorted((gap for gap in gaps if shared[gap] < SHARED_FEATURES), key=lambda gap: shared[gap])
        if not weak:
            break
        added = []
        for gap in weak[: most - len(chosen)]:
            number = between(*gap)
            if number is None:
                closed.add(gap)
            else:
                added.append(number)
        chosen = sorted({*chosen, *added})
    return chosen


def find_features(image: np.ndarray) -> Features:
    """Features of a small copy of an (H, W, 3) uint8 RGB image."""
    small = bound_to_grey(image, SIDE_PX)
    return Features(*find_root_sift(small, cv2.SIFT.create(nfeatures=FEATURES, contrastThreshold=CONTRAST)), small.shape[1::-1])


def count_shared(one: Features, other: Features) -> int:
    """How many clear, mutual matches of two frames fit one epipolar geometry."""
    first, second = match_clearly(one, other)
    if len(first) < LEAST_MATCHES:
        return 0
    _, inliers = cv2.findFundamentalMat(first, second, cv2.FM_RANSAC, EPIPOLAR_PX, 0.999)
    return 0 if inliers is None else int(inliers.sum())


def match_clearly(one: Features, other: Features) -> tuple[np.ndarray, np.ndarray]:
    """(M, 2) float32 places in both frames of the matches that are mutual, and clearly nearer than the second best."""
    if min(len(one.points_px), len(other.points_px)) < LEAST_MATCHES:
        return one.points_px[:0], other.points_px[:0]
    likeness = one.descriptors @ other.descriptors.T
    rows, best = np.arange(len(likeness)), likeness.argmax(1)
    nearest = likeness[rows, best]
    mutual = nearest == likeness.max(0)[best]
    likeness[rows, best] = -np.inf
    clear = mutual & ((1 - nearest) < RATIO**2 * (1 - likeness.max(1)))
    return one.points_px[clear], other.points_px[best[clear]]
