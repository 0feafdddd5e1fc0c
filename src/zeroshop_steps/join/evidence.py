"""Whether a way to lay a pass to another is right: the outlines of both must agree, and their pictures show the same.

The outlines of a can fit any turn about its axis, and print may stand on two sides, so neither is enough alone. Only outlines that fit far
worse in every other way are, as those of a plain drill.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, to_matrix
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_camera, transform_points
from zeroshop_steps.join.outline_ways import find_ways_by_outlines
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.join.ways import Way
from zeroshop_steps.register.photometry.view_similarity import Chances
from zeroshop_steps.register.submodels.appearance import Likeness, compare_groups
from zeroshop_steps.register.submodels.outline_alignment import CameraGroup, measure_between_deg, measure_misses

LARGEST_MISS_PX = 2.5
"""By how much rays through the rims may miss the masks of the other pass in the mean, per 1000 px: exact masks miss by 0.1, found ones
by up to 2."""
SURE_MISS_PX, ELSEWHERE_PX, ELSEWHERE_TIMES = 2.0, 1.0, 2.0
"""Outlines alone show how the object lies where they miss by so little, and in every other way by so much more and so many times as much.
Of plain objects, the right way misses by 0.06 at most with exact masks and by 0.6 to 0.9 with masks wrong by 1.5 px, the next by 1.3 more.
Of those that look alike in several ways, a wrong one misses by up to 0.1 more, and by 0.3 less where cameras and masks are wrong."""
SAME_SIDE_DEG = 20.0  # between the ups of two passes: an object that was turned over differs by 60 and more
MANY_PAIRS = 100  # a way that so many points support needs no comparison with those of the outlines
SAME_WAY_DEG, SAME_WAY_SHARE = 15.0, 0.04
"""Ways that differ by a smaller turn are one, and so are those that move nothing farther apart than this share of the object's size: thin
things may roll by more."""
SURE_PAIRS = 40  # of points that match: so many say that pictures show the same, where too few patches could be compared


@dataclass(frozen=True)
class Judgement:
    """How well a way fits.

    Attributes:
        way: the way.
        miss_px: by how much the rays of each pass miss the masks of the other in the mean, px per 1000 px of the image.
        likeness: how far pictures of both passes show the same.
        elsewhere_px: the same as `miss_px` in the best other way; None where other ways were not looked for.
    """

    way: Way
    miss_px: float
    likeness: Likeness
    elsewhere_px: float | None = None

    @property
    def clear(self) -> bool:
        """Whether the outlines fit in this way alone."""
        if self.elsewhere_px is None or self.miss_px > SURE_MISS_PX:
            return False
        return self.elsewhere_px >= max(self.miss_px + ELSEWHERE_PX, ELSEWHERE_TIMES * self.miss_px)

    @property
    def verdict(self) -> str:
        """`right`, `wrong`, or `open`: it fits, but nothing shows that it is right."""
        if self.miss_px > LARGEST_MISS_PX or self.likeness.different:
            return "wrong"
        return "right" if self.likeness.same or self.way.pairs >= SURE_PAIRS or self.clear else "open"

    def figures(self) -> dict[str, Any]:
        """For the record."""
        found = {"verdict": self.verdict, "point_pairs": self.way.pairs, "miss_px": round(self.miss_px, 3)}
        if self.elsewhere_px is not None:
            found |= {"elsewhere_px": round(self.elsewhere_px, 3)}
        return {**found, **self.likeness.figures()}


@dataclass(frozen=True)
class PassObservation:
    """What a pass shows of the object, in its own frame.

    Attributes:
        views: sorted by name.
        group: their outlines.
        chances: by pictures, of patches of its own views and of those that were compared with them.
    """

    views: list[View]
    group: CameraGroup
    chances: dict[Path, Chances] = field(default_factory=dict)

    @classmethod
    def of(cls, one: Pass) -> "PassObservation":
        """Read the masks of a pass."""
        views = make_views(one)
        return cls(views, CameraGroup([view.camera for view in views], {view.camera.name: view.mask() for view in views}))


def judge_ways(
    ways: list[Way], target: PassObservation, source: PassObservation, find_others: Callable[[], list[Judgement]]
) -> list[Judgement]:
    """Judge the ways that print supports, and those that the outlines allow where print leaves a doubt.

    A thing whose sides look alike may match as if it had not been turned over, or in a few points that are not the same. So a way in which
    it was not, or that few points support, counts only if the outlines and pictures rule out the others.
    """
    found = [judge(way, target, source) for way in ways]
    right = choose(found)
    if right is None and any(one.verdict == "right" for one in found):
        return found
    if right and right.way.pairs >= MANY_PAIRS and measure_turn_deg(right.way, target, source) > SAME_SIDE_DEG:
        return found
    by_outlines = find_others()
    if right:
        return found + [one for one in by_outlines if not is_same(one.way, right.way, target, source)]
    return by_outlines if not found or any(one.verdict != "wrong" for one in by_outlines) else found


def is_same(one: Way, other: Way, target: PassObservation, source: PassObservation) -> bool:
    """Whether two ways are one, nearly."""
    if measure_between_deg(one.target_from_source, other.target_from_source) <= SAME_WAY_DEG:
        return True
    apart = [transform_points(source.group.points, way.target_from_source) for way in (one, other)]
    return bool(np.linalg.norm(apart[0] - apart[1], axis=1).max() <= SAME_WAY_SHARE * 2 * target.group.radius)


def measure_turn_deg(way: Way, target: PassObservation, source: PassObservation) -> float:
    """By how much the object was turned over between two passes: the angle between their ups."""
    rotation = way.target_from_source[:3, :3] / compute_scale(way.target_from_source)
    return float(np.degrees(np.arccos(np.clip(target.group.up @ rotation @ source.group.up, -1, 1))))


def choose(found: list[Judgement]) -> Judgement | None:
    """The one way that is right; None where none is, or where another may be right as well.

    Where the outlines fit in one way alone, the others that nothing else shows to be right are ruled out.
    """
    possible = [one for one in found if one.verdict != "wrong"]
    if any(one.clear for one in possible):
        possible = [one for one in possible if one.verdict == "right"]
    return possible[0] if len(possible) == 1 and possible[0].verdict == "right" else None


def judge(way: Way, target: PassObservation, source: PassObservation, elsewhere_px: float | None = None) -> Judgement:
    """Judge a way by the views of both passes and their outlines; `elsewhere_px` as in the judgement."""
    misses = measure_misses(target.group, source.group, way.target_from_source)
    moved = [View(transform_camera(view.camera, way.target_from_source), view.image_path, view.mask_path) for view in source.views]
    likeness = compare_groups([*target.views, *moved], {view.camera.name for view in source.views}, target.chances)
    return Judgement(way, float(misses.mean()), likeness, elsewhere_px)


def judge_by_outlines(target: PassObservation, source: PassObservation) -> list[Judgement]:
    """Find the ways in which the outlines fit best, and judge them: for passes whose print does not tell how they lie to each other."""
    ways = find_ways_by_outlines(target.group, source.group)
    found = []
    for number, one in enumerate(ways):
        elsewhere_px = min((other.miss_px for other in ways[:number] + ways[number + 1 :]), default=np.inf)
        found.append(judge(Way(one.target_from_source, 0), target, source, elsewhere_px))
    return found


def make_views(one: Pass) -> list[View]:
    """The views of a pass in its own frame, sorted by name."""
    views = []
    for image in sorted(one.model.images.values(), key=lambda image: image.name):
        if image.has_pose:
            lens = one.model.cameras[image.camera_id]
            camera = Camera(image.name, lens.width, lens.height, np.array(lens.calibration_matrix()), to_matrix(image.cam_from_world()))
            views.append(View(camera, Path(one.images[image.name]), Path(one.masks[image.name])))
    return views
