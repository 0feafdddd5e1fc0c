"""Find the object in registered photos: for each plane that it may stand on, masks by all cues; the score chooses."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.segment.cues import prompted
from zeroshop_steps.segment.cues.fusion import estimate_odds
from zeroshop_steps.segment.mask_hull import Solution, close_holes, solve
from zeroshop_steps.segment.objects import (
    VOTE_ODDS,
    NothingFound,
    Room,
    SceneObjects,
    TwoObjects,
    cut_block,
    find_objects,
    find_whole,
    fit_room,
    join_fragments,
)
from zeroshop_steps.segment.outlines.prompts import PromptedSegmenter
from zeroshop_steps.segment.outlines.windows import CLOSER, choose_windows, lay_back, scale_windows
from zeroshop_steps.segment.photometry.exposure import Exposure
from zeroshop_steps.segment.quality.mask_quality import MaskQuality, MasksRejected, compare_with_hull, describe_quality
from zeroshop_steps.segment.quality.mask_scores import REASONS, RIGHT_OVERLAP, Measures, Score, measure, score
from zeroshop_steps.segment.quality.tidy_mask import tidy_mask
from zeroshop_steps.segment.scene import MaskScene, read_mask_scene, start_guess
from zeroshop_steps.segment.support import Candidate, propose_supports, settle_support
from zeroshop_steps.segment.support_voxels import VoxelGrid, count_votes, render_silhouettes

WIDTH_PX = 480  # masks are cut at this width at most; time grows with its square
SURE, LEAST = 0.97, 0.93
"""The probability from which on no other object on a plane is tried, and below which other planes are tried, and masks are refused: on the
captures of the tune half, their objects left out of the fit, the right masks less five times the wrong ones that are accepted are most
(benchmarks/fit_masks.py)."""
MOST_ROOMS = 4  # that are tried for an object
EQUAL, RIVAL = 0.9, 0.6  # how likely another object is meant: either may be, and it is tried, too
LEAST_HALF, LEAST_COMMON = 6, 0.3  # photos in half of the capture, and share of the voxels that both halves show of an object that stays
LEAST_SIZE = 0.5  # of the smaller thing that the halves show, in voxels of the larger one: an object that moved keeps its size
SETTLED = 0.003  # a plane that moves less than this, in distances of the cameras, needs no new masks


@dataclass(frozen=True)
class Hypothesis:
    """Masks on one plane.

    Attributes:
        candidate: the plane.
        settled: whether the views agreed on its height.
        scene: the photos, or windows of them, that were cut.
        solution, qualities, measures, score: the masks, and how good they are.
        objects: the number of objects that were found.
    """

    candidate: Candidate
    settled: bool
    scene: MaskScene
    solution: Solution
    qualities: list[MaskQuality]
    measures: Measures
    score: Score
    objects: int


def find_masks(
    views: Sequence[View],
    model: SparseModel,
    exposure: Exposure,
    saliency: Sequence[np.ndarray] | None,
    network: SalientObjectNetwork | None,
    width_px: int = WIDTH_PX,
    seed: int = 0,
    place: np.ndarray | None = None,
    segmenter: PromptedSegmenter | None = None,
) -> tuple[list[np.ndarray], dict[str, Any]]:
    """(H, W) bool masks of all views, of the photos' sizes, and the record of their quality.

    Args:
        views, model: the registered views and their sparse points.
        exposure: of the views.
        saliency, network: what a salient-object network sees in each whole photo, (h, w) of 0 to 1, and the network; None without one.
        width_px: photos are cut at this width.
        seed: of RANSAC.
        place: (3,) world position of the object that is meant; None for the likeliest.
        segmenter: cuts the object out of each photo; None without it.

    Raises:
        StepError: nothing is found, or the masks are likely wrong.
    """
    scene = read_mask_scene(views, model, exposure, saliency, width_px, segmenter, seed)
    best: Hypothesis | None = None
    failures: list[tuple[NothingFound, Candidate]] = []
    for candidate in propose_supports(model, views, scene.planes):
        try:
            for hypothesis in try_support(scene, candidate, network, place=place):
                if best is None or hypothesis.score.probability > best.score.probability:
                    best = hypothesis
        except NothingFound as error:
            failures.append((error, candidate))
        if best is not None and best.score.probability >= LEAST:
            break
    if best is None:
        failure, candidate = failures[0]
        moved = "" if isinstance(failure, TwoObjects) or place is not None else find_motion(scene, candidate)
        raise NothingFound(moved) if moved else failure
    names = [view.camera.name for view in views]
    masks = [
        tidy_mask(close_holes(mask, odds), hull)
        for mask, odds, hull in zip(best.solution.masks, best.solution.odds, best.solution.hulls, strict=True)
    ]
    whole = map_in_threads(lay_back, masks, best.scene.windows, views)
    if best.score.probability < LEAST:
        if place is None and (moved := find_motion(scene, best.candidate)):
            raise MasksRejected(moved, whole, set())
        raise MasksRejected(
            f"the object was not told from what is around it: {REASONS[best.score.doubt]}. Put it alone on a ground of other colours, keep"
            " all of it in the photos, do not move it, or draw masks and name their folder in objects.tsv",
            whole,
            {name for name, quality in zip(names, best.qualities, strict=True) if quality.fault},
        )
    return whole, _describe(best, names)


def try_support(
    scene: MaskScene,
    candidate: Candidate,
    network: SalientObjectNetwork | None,
    without: Sequence[str] = (),
    place: np.ndarray | None = None,
) -> Iterator[Hypothesis]:
    """Masks on one plane, by all cues but those in `without`: of the likeliest object, of the next if it may be meant instead, and of
    the likeliest with what may be fragments of it; and of what Segment Anything takes for the whole of an object.

    Where the object that is meant has a `place`, (3,) in the world, of that one alone.

    Raises:
        NothingFound: nothing is found on it.
    """
    if place is not None:
        support, found, odds = find_all_on(scene, candidate)
        yield from _cut_out(scene, candidate, support, found, found.find_at(place), odds, network, without, None)
        return
    support, found, odds = find_on(scene, candidate, without)
    rival = found.measure_rival(1)
    if rival > EQUAL:
        raise TwoObjects(
            "two objects are equally near to the point that the cameras look at: take one away, or keep the one that is meant in the middle"
            " of the photos"
        )
    for number in (1, 2)[: 1 if rival < RIVAL else 2]:
        tried = list(_cut_out(scene, candidate, support, found, number, odds, network, without, found.measure_rival(number)))
        with contextlib.suppress(NothingFound):
            tried += _cut_out_whole(scene, max(tried, key=lambda hypothesis: hypothesis.score.probability), network, without, rival)
        yield from tried
        if max(hypothesis.score.probability for hypothesis in tried) >= SURE:
            return
    joined = join_fragments(found, scene.cameras)
    if joined is not None:  # what is joined may be the rival, so the doubt stays
        yield from _cut_out(scene, candidate, support, joined, 1, odds, network, without, rival)


def find_on(
    scene: MaskScene, candidate: Candidate, without: Sequence[str] = ()
) -> tuple[SceneSupport | None, SceneObjects, list[np.ndarray]]:
    """A plane, the objects on it, and the log odds, (h, w) in each photo, that told them. Raises NothingFound where there are none."""
    support = scene.place(candidate.support)
    odds = estimate_odds(scene, start_guess(scene, support), without)
    return support, find_objects(scene.cameras, support, *scene.focus, odds), odds


def find_all_on(scene: MaskScene, candidate: Candidate) -> tuple[SceneSupport | None, SceneObjects, list[np.ndarray]]:
    """As `find_on`, without the salient-object network, which sees one of several objects, or the sheet that they stand on."""
    return find_on(replace(scene, saliency=None), candidate)


def _cut_out(
    scene: MaskScene,
    candidate: Candidate,
    support: SceneSupport | None,
    found: SceneObjects,
    number: int,
    odds: Sequence[np.ndarray],
    network: SalientObjectNetwork | None,
    without: Sequence[str],
    rival: float | None,
) -> Iterator[Hypothesis]:
    """Masks of the object of this number, also in longer rooms where it reaches the end of one; `odds`, (h, w), found it.

    `rival` is how likely another one is meant; None where the user said which, and it does not matter what the network sees in the photos.
    """
    room: Room | None = Room(own := found.labels == number, own)
    for _ in range(MOST_ROOMS):
        if room is None:
            return
        block = cut_block(found, number, room)
        closer_scene, closer_support = look_closer(scene, support, block.grid, block.reach, network)
        votes = count_votes(block.grid, block.index, scene.cameras, odds, VOTE_ODDS)
        solution = solve(closer_scene, closer_support, block, votes, without)
        settled = None
        if closer_support is not None and not candidate.fitted:
            settled = settle_support(replace(closer_support, distance=scene.focus[1]), closer_scene, solution)
            if settled is not None and abs(settled.offset - closer_support.offset) > SETTLED * scene.focus[1]:
                solution = solve(closer_scene, replace(settled, distance=closer_support.distance), block, votes, without)
        qualities = compare_with_hull([mask > 0.5 for mask in solution.masks], solution.hulls)
        longer = fit_room(found, room, solution.grid, solution.occupied)
        truncated = longer is not None and longer.reach is not longer.own
        measures = measure(closer_scene, solution, qualities, rival or 0.0, truncated)
        if rival is None:
            measures = replace(measures, network_difference=0.0)
        yield Hypothesis(candidate, settled is not None, closer_scene, solution, qualities, measures, score(measures), found.count)
        room = longer


def _cut_out_whole(
    scene: MaskScene, part: Hypothesis, network: SalientObjectNetwork | None, without: Sequence[str], rival: float
) -> Iterator[Hypothesis]:
    """Masks of what Segment Anything takes for the whole of an object, if that is more or less. Raises NothingFound where it is nothing."""
    odds = prompted.see_whole(scene, part.scene, part.solution.guess)
    if odds is None:
        return
    support = scene.place(part.candidate.support)
    points = part.solution.grid.centres(np.argwhere(part.solution.occupied))
    whole = find_objects(scene.cameras, support, *scene.focus, odds)
    number, overlap = find_whole(whole, scene.cameras, points)
    if overlap < RIGHT_OVERLAP:
        yield from _cut_out(scene, part.candidate, support, whole, number, odds, network, without, rival)


def find_motion(scene: MaskScene, candidate: Candidate) -> str:
    """What to say where the first half of the photos shows the object elsewhere than the second half; empty where it does not."""
    middle = len(scene.views) // 2
    if middle < LEAST_HALF:
        return ""
    support, halves = scene.place(candidate.support), []
    for part in (slice(middle), slice(middle, None)):
        half = scene.take(part)
        try:
            halves.append(find_objects(half.cameras, support, *scene.focus, estimate_odds(half, start_guess(half, support))))
        except NothingFound:
            return ""
    first, second = (half.labels == 1 for half in halves)
    smaller, larger = sorted((first.sum(), second.sum()))
    if (first & second).sum() >= LEAST_COMMON * smaller or smaller < LEAST_SIZE * larger:
        return ""
    names = [scene.views[index].camera.name for index in (middle - 1, middle)]
    return (
        f"until {names[0]} the photos show a thing elsewhere than from {names[1]} on: the object moved, or another thing stands out more in"
        " a half of them; film it alone, without touching it or the ground, or register it by itself (scene video_segmented)"
    )


def look_closer(
    scene: MaskScene, support: SceneSupport | None, grid: VoxelGrid, occupied: np.ndarray, network: SalientObjectNetwork | None
) -> tuple[MaskScene, SceneSupport | None]:
    """The scene in windows around an object that is small in the photos, and the plane with lengths as seen through them.

    Args:
        scene: the whole photos.
        support: the plane.
        grid, occupied: the object's voxels, (X, Y, Z) bool.
        network: looks at the windows, too; None where it shall not.
    """
    silhouettes = render_silhouettes(grid, occupied, scene.cameras)
    windows, closer = choose_windows(silhouettes)
    if closer > CLOSER:
        return scene, support
    middle = grid.centres(np.argwhere(occupied)).mean(0)
    if support is not None:
        support = replace(support, distance=closer * support.distance, focus=middle)
    return scene.look_closer(scale_windows(windows, scene.cameras, scene.views), network), support


def _describe(best: Hypothesis, names: list[str]) -> dict[str, Any]:
    support = best.solution.guess.support
    record: dict[str, Any] = {
        **describe_quality(best.qualities, names),
        "objects": best.objects,
        "probability": round(best.score.probability, 4),
        "measures": {name: round(value, 4) for name, value in asdict(best.measures).items()},
        "image_width_px": best.scene.width_px,
        "plane_from": "points" if best.candidate.fitted else "views" if best.settled else "object",
    }
    if support is not None:
        record |= {"plane_inliers": support.inliers, "plane": {"normal": support.normal.tolist(), "offset": support.offset}}
    return record
