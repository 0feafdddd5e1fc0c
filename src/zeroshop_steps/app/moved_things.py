"""Find out whether a thing moves against its background, from points that are followed through short pieces of a film.

One camera before things at rest has one epipolar geometry for all points. Where whole parts of the picture miss it, they move.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.capture.frame_quality import bound_to_grey
from zeroshop_steps.geometry.imaging.image_overlap import SIDE_PX

POINTS, QUALITY, APART_PX = 1500, 0.003, 6  # of the corners that are followed
WINDOW_PX = (15, 15)  # of the tracker (Lucas and Kanade, 1981; pyramids: Bouguet, 2000)
RETURN_PX = 0.5  # by which a point may miss where it came from, followed back
FLOW_QUANTILE = 0.95  # of the ways of the points
ENOUGH_FLOW_PX, LEAST_FLOW_PX = 30.0, 8.0  # way of the points at which a piece ends, and below which it tells nothing
STILL_PX, STILL_SHARE, LEAST_MOVING = 1.0, 0.3, 30  # ways of points that stand still, their share before a tripod, and points besides
MOST_STEPS = 16  # of a piece
LEAST_KEPT, LEAST_POINTS = 0.4, 100  # of the corners that are still followed; frames too far apart lose more
EPIPOLAR_PX, FLOW_SHARE = 1.5, 0.05
"""A point misses by so much, and this share of the way: phones expose rows one after the other."""
NEIGHBOURS = 8  # whose median must miss, too: single points slide along edges and highlights

PIECES, LEAST_PIECES = 10, 4  # of a film that are looked at, and that must tell
MOVED_SHARE, MOVED_PIECES = 0.05, 0.25
"""Of the points move, in this share of the pieces: 0.15 of a bear that hands move; 0 to 0.002 of an apple, with a fast camera."""


@dataclass(frozen=True)
class Piece:
    """Points that were followed through a piece of a film.

    Attributes:
        first, last: (P, 2) float64 their places in its first and last frame, in pixels of the small copies.
    """

    first: np.ndarray
    last: np.ndarray

    @property
    def ways_px(self) -> np.ndarray:
        """(P,) how far each point went."""
        ways: np.ndarray = np.linalg.norm(self.last - self.first, axis=1)
        return ways

    @property
    def flow_px(self) -> float:
        """How far what moves most went, single points apart."""
        return float(np.quantile(self.ways_px, FLOW_QUANTILE))

    @property
    def is_still(self) -> bool:
        """Whether much of the picture stands still, as that of a camera on a tripod, while other parts move."""
        return bool((self.ways_px < STILL_PX).mean() > STILL_SHARE)

    def measure_moved(self) -> float | None:
        """The share of the moving points that go otherwise than the rest, and their neighbours too; None where the piece does not tell."""
        if self.flow_px < LEAST_FLOW_PX:
            return None
        moving = self.ways_px >= STILL_PX if self.is_still else np.ones(len(self.first), bool)
        first, last = self.first[moving], self.last[moving]
        limit_px = EPIPOLAR_PX + FLOW_SHARE * self.flow_px
        if len(first) < LEAST_MOVING:
            return None
        fundamental, _ = cv2.findFundamentalMat(first, last, cv2.FM_RANSAC, limit_px / 2, 0.999)
        if fundamental is None or fundamental.shape != (3, 3):
            return None
        one, other = (np.column_stack([places, np.ones(len(places))]) for places in (first, last))
        lines, back = one @ fundamental.T, other @ fundamental
        # Sampson's distance (Hartley and Zisserman 2004, eq. 11.9).
        steepness = np.sqrt((lines[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1))
        misses_px = np.abs((other * lines).sum(1)) / np.maximum(steepness, 1e-12)
        near = cKDTree(first).query(first, NEIGHBOURS)[1]
        return float((np.median(misses_px[near], axis=1) > limit_px).mean())


def judge_motion(pieces: Iterable[Piece]) -> tuple[list[str], list[str]]:
    """What prevents a mesh, and what makes it worse, in words: a thing that moves, and a background that stands still while it turns."""
    told = [(moved, piece.is_still) for piece in pieces if (moved := piece.measure_moved()) is not None]
    if len(told) < LEAST_PIECES:
        return [], []
    moved, still = np.array(told).T
    if np.quantile(moved, 1 - MOVED_PIECES) > MOVED_SHARE:
        return [
            f"in {int((moved > MOVED_SHARE).sum())} of {len(told)} pieces of the way, parts of the picture move against each other: put the"
            " object down, keep hands and all else still, and move the camera around it"
        ], []
    if still.mean() > 0.5:
        return [], [
            "the background stands still while the object turns: move the camera instead, hang a plain cloth behind it, or give masks"
        ]
    return [], []


def follow_points(frames: Iterable[np.ndarray], starts: Iterable[int]) -> Iterator[Piece]:
    """Follow corners from some frames on, until the picture has moved enough.

    Args:
        frames: (H, W, 3) uint8 RGB, in the order of the film.
        starts: numbers of the frames with which pieces begin; one that lies within the piece before begins where that ends.
    """
    waiting = sorted(starts, reverse=True)
    numbered = enumerate(frames)
    for number, frame in numbered:
        if waiting and number >= waiting[-1]:
            waiting.pop()
            later = (bound_to_grey(one, SIDE_PX) for _, one in islice(numbered, MOST_STEPS))
            if piece := _follow_piece(bound_to_grey(frame, SIDE_PX), later):
                yield piece


def _follow_piece(before: np.ndarray, later: Iterable[np.ndarray]) -> Piece | None:
    first = now = cv2.goodFeaturesToTrack(before, POINTS, QUALITY, APART_PX)
    if len(np.atleast_1d(first)) < LEAST_POINTS:  # None where there is no corner at all
        return None
    least, piece = max(LEAST_POINTS, LEAST_KEPT * len(first)), None
    for grey in later:
        if grey.shape != before.shape:
            break
        there, found, _ = cv2.calcOpticalFlowPyrLK(before, grey, now, now.copy(), winSize=WINDOW_PX)
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(grey, before, there, there.copy(), winSize=WINDOW_PX)
        kept = np.logical_and(found, found_back).ravel() & (np.linalg.norm((back - now)[:, 0], axis=1) < RETURN_PX)
        first, now, before = first[kept], there[kept], grey
        if kept.sum() < least:
            break
        piece = Piece(first[:, 0].astype(np.float64), now[:, 0].astype(np.float64))
        if piece.flow_px > ENOUGH_FLOW_PX:
            break
    return piece
