"""How likely masks are right, by what can be measured without the truth: one score for every hypothesis.

Masks are right if in the median photo they overlap with the object by `RIGHT_OVERLAP`. The probability is a logistic regression on the
measures, fitted on hypotheses for many captures, right and wrong ones (benchmarks/fit_masks.py).
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage
from scipy.special import expit

from zeroshop_steps.geometry.cameras.registered_views import space_evenly
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.segment.cues import points as points_cue
from zeroshop_steps.segment.cues import prompted
from zeroshop_steps.segment.mask_hull import Solution
from zeroshop_steps.segment.quality.mask_quality import MaskQuality
from zeroshop_steps.segment.quality.plane_sweep import WINDOW_PX, shrink, sweep
from zeroshop_steps.segment.scene import MaskScene
from zeroshop_steps.segment.support import find_clusters
from zeroshop_steps.segment.support_voxels import VoxelGrid

CONFIRMED = 0.75
"""Quantile of the photos' overlaps with the network. It fails in single photos, but what it misses differs: where masks agree with each
other, and a part of them with the network, all are confirmed."""
WEIGHTS = Path(__file__).with_name("score_weights.json")
RIGHT_OVERLAP = 0.9  # from here on, a mesh lacks no part
LEAST_CLUSTER = 30  # points; fewer tell little about the masks
AROUND, LINK, LIFTED, PART, FAR = 1.5, 0.12, 0.05, 0.3, 0.15
"""Shares of the object's size: points so near to its middle, so close to each other and so high above the ground may be its own; the
share of a cluster in the hull that makes it the object's; and how far from the hull a point is not the object's."""

SWEPT_VIEWS = 12  # that a plane is swept through, evenly spread: more tell the same
SURE_CORRELATION, AHEAD, LEAST_TOLD = 0.8, 0.3, 0.01
"""From which correlation on, and so far ahead of all other planes, a sweep tells where a pixel lies; and the share of the masks' pixels
below which it tells little."""


@dataclass(frozen=True)
class Measures:
    """Measures of masks, each 0 for perfect ones.

    Attributes:
        rival: how likely another object is meant (objects.measure_rival).
        contradiction: of the median mask's area, what the other views' masks contradict.
        mean_contradiction: the same of the mean mask.
        faulty: share of the masks that are empty, contradicted or of another size than the others predict.
        network_difference: square root of 1 less the overlap with what a salient-object network sees, reached in a quarter of the photos;
            0 without one; `pointed_difference` where that is less: one of them confirms the masks. With the root, small differences tell
            more, as they do: the likelihood of objects left out of the fit is higher.
        prompted_difference: the same of what Segment Anything cuts out in the box around the hull of the other photos, of the median photo;
            0 without it.
        pointed_difference: the same with the largest thing that it sees at points of the hull, in the best quarter of the photos.
        points_missed: of the sparse points that are connected with those of the object, the share outside its hull.
        points_contradicted: of the sparse points that masks show, the share that lies elsewhere in space or on the ground.
        flat: of what a plane sweep tells within the masks, the share that lies on the ground or far away; 1 from as much on as right masks
            cannot have.
        truncated: 1 where the hull reaches the end of the room in which it was searched for, so a part may lie beyond it.
        cut_off: how much of the photo's border the mask covers, of the square root of its area, in the median photo.
    """

    rival: float
    contradiction: float
    mean_contradiction: float
    faulty: float
    network_difference: float
    prompted_difference: float
    pointed_difference: float
    points_missed: float
    points_contradicted: float
    flat: float
    truncated: float
    cut_off: float


REASONS = {
    "rival": "another thing is as likely to be meant",
    "contradiction": "the masks of the photos contradict each other",
    "mean_contradiction": "the masks of some photos contradict the others",
    "faulty": "many masks are empty or contradict the others",
    "network_difference": "the network sees something else than what stands on the ground",
    "prompted_difference": "Segment Anything cuts something else out of the photos",
    "pointed_difference": "Segment Anything sees a part of a larger thing in them",
    "points_missed": "sparse points of the object lie outside the masks",
    "points_contradicted": "the masks show points of other things or of the ground",
    "flat": "the masks show what lies flat on the ground, such as a sheet of paper below the object",
    "truncated": "the object goes on beyond where it was found",
    "cut_off": "the object is cut off at the border of most photos",
}


def measure(scene: MaskScene, solution: Solution, qualities: Sequence[MaskQuality], rival: float, truncated: bool) -> Measures:
    """Measure the masks of a solution.

    Args:
        scene, solution: what was cut, and how.
        qualities: the masks compared with their hull.
        rival: how likely another object is meant.
        truncated: whether the hull reaches the end of its room.
    """
    masks = [mask > 0.5 for mask in solution.masks]
    network_difference = 0.0
    looks = [maps for maps in (scene.saliency, scene.closer_saliency) if maps is not None]
    if looks:
        best = [max(compute_overlap(mask, seen > 0.5) for seen in maps) for mask, maps in zip(masks, zip(*looks, strict=True), strict=True)]
        network_difference = math.sqrt(1 - float(np.quantile(best, CONFIRMED)))
    # Photos beside which the object lies say nothing; some of several objects do so in many.
    shown = [mask.any() or hull.any() for mask, hull in zip(masks, solution.hulls, strict=True)]
    judged = [quality for quality, of_object in zip(qualities, shown, strict=True) if of_object]
    asked = _measure_prompted(scene, solution, masks)
    prompted_difference, pointed_difference = asked or (0.0, 0.0)
    contradictions = [min(quality.disagreement or 0.0, 1.0) for quality in judged]
    return Measures(
        rival=rival,
        contradiction=float(np.median(contradictions)),
        mean_contradiction=float(np.mean(contradictions)),
        faulty=float(np.mean([quality.fault is not None for quality in judged])),
        network_difference=min(network_difference, pointed_difference) if asked else network_difference,
        prompted_difference=prompted_difference,
        pointed_difference=pointed_difference,
        points_missed=_measure_missed(scene, solution),
        points_contradicted=_measure_contradicted(scene, solution, masks),
        flat=_measure_flat(scene, solution, masks),
        truncated=float(truncated),
        cut_off=float(np.median([_measure_cut_off(mask, quality) for mask, quality in zip(masks, qualities, strict=True)])),
    )


def _measure_prompted(scene: MaskScene, solution: Solution, masks: Sequence[np.ndarray]) -> tuple[float, float] | None:
    see = prompted.prepare(scene, solution.guess)
    if see is None:
        return None
    overlaps = []
    for index, mask in enumerate(masks):
        boxed, _, pointed, _, known = see(index)
        if known.any():
            overlaps.append([compute_overlap(mask, odds > 0) for odds in (boxed, pointed)])
    if not overlaps:
        return None
    in_box, at_points = np.array(overlaps).T
    return math.sqrt(1 - float(np.median(in_box))), math.sqrt(1 - float(np.quantile(at_points, CONFIRMED)))


def _measure_cut_off(mask: np.ndarray, quality: MaskQuality) -> float:
    return min(2 * sum(mask.shape) * quality.border_share / float(np.sqrt(max(mask.sum(), 1))), 1.0)


def _measure_missed(scene: MaskScene, solution: Solution) -> float:
    """Of the dense clusters of sparse points that the hull has a part of, the share that lies outside of it."""
    points, support = scene.model.points, solution.guess.support
    occupied = solution.grid.centres(np.argwhere(solution.occupied))
    middle, size = occupied.mean(0), float(np.ptp(occupied @ solution.grid.axes.T, axis=0).max())
    near = np.linalg.norm(points - middle, axis=1) < AROUND * size
    if support is not None:
        near &= support.heights(points) > LIFTED * size
    inside = total = 0
    for cluster in find_clusters(points[near], LINK * size):
        within = int(solution.grid.look_up(ndimage.binary_dilation(solution.occupied, iterations=2), cluster).sum())
        if within > PART * len(cluster):
            inside, total = inside + within, total + len(cluster)
    return 1 - inside / total if total >= LEAST_CLUSTER else 0.0


def _measure_contradicted(scene: MaskScene, solution: Solution, masks: Sequence[np.ndarray]) -> float:
    seen, points = scene.model.seen, scene.model.points
    if seen is None:
        return 0.0
    elsewhere = _find_outside(points, solution)
    raised = points_cue.measure_raised(scene, solution.guess)
    if raised is not None:
        elsewhere |= raised < 0
    shown = wrong = 0
    for camera, mask, rows_of_points in zip(scene.cameras, masks, seen, strict=True):
        rows, columns, _, inside = camera.find_pixels(points[rows_of_points])
        on_mask = mask[rows[inside], columns[inside]]
        shown += int(on_mask.sum())
        wrong += int((on_mask & elsewhere[rows_of_points][inside]).sum())
    return wrong / max(shown, LEAST_CLUSTER)


def _measure_flat(scene: MaskScene, solution: Solution, masks: Sequence[np.ndarray]) -> float:
    support = solution.guess.support
    ground = points_cue.choose_ground(scene, solution.guess) or support
    if ground is None:
        return 0.0
    ground = scene.place(ground) if support is None else replace(ground, focus=support.focus, distance=support.distance)
    assert ground is not None, "a plane that is placed is one"
    photos = map_in_threads(shrink, scene.images, scene.cameras)

    def count(index: int) -> np.ndarray:
        mask = cv2.resize(masks[index].astype(np.uint8), photos[index].grey.shape[::-1], interpolation=cv2.INTER_NEAREST)
        inner = cv2.erode(mask, np.ones((WINDOW_PX + 2,) * 2)) > 0
        if not inner.any():
            return np.zeros(3, int)
        part = ndimage.find_objects(mask)[0]
        inner, (raised, elsewhere) = inner[part], sweep(photos, index, ground, part)
        told = [inner & (one > SURE_CORRELATION) & (one - other > AHEAD) for one, other in ((elsewhere, raised), (raised, elsewhere))]
        return np.array([part.sum() for part in (*told, inner)])

    flat, up, shown = np.sum(map_in_threads(count, space_evenly(len(photos), SWEPT_VIEWS)), axis=0)
    return min(float(flat / max(flat + up, LEAST_TOLD * shown, 1)) / (1 - RIGHT_OVERLAP), 1.0)


def _find_outside(points: np.ndarray, solution: Solution) -> np.ndarray:
    """(P,) bool: which (P, 3) points lie far from the hull that the masks were cut with."""
    assert solution.guess.hull is not None, "masks are cut with a hull"
    occupied, grid = solution.guess.hull.occupied, solution.grid
    reach = int(FAR * max(np.ptp(np.argwhere(occupied), axis=0).max(), 1))
    near = ndimage.distance_transform_edt(~np.pad(occupied, reach + 1)) <= reach
    padded = VoxelGrid(grid.axes, grid.origin - (reach + 1) * grid.side * grid.axes.sum(0), grid.side, near.shape)
    return ~padded.look_up(near, points)


@dataclass(frozen=True)
class Score:
    """The probability that masks are right, and the measure that speaks most against them."""

    probability: float
    doubt: str


@cache
def _load_weights() -> tuple[dict[str, float], float]:
    stored = json.loads(WEIGHTS.read_text())
    return stored["weights"], stored["offset"]


def score(measures: Measures) -> Score:
    """Rate masks by their measures."""
    weights, offset = _load_weights()
    against = {name: weights[name] * value for name, value in asdict(measures).items()}
    probability = float(expit(offset - sum(against.values())))
    return Score(probability, max(against, key=lambda name: against[name]))
