"""Whether a way to lay a pass to another is right: the outlines of both must agree, and their pictures show the same.

Neither is enough alone: the outlines of a can fit any turn about its axis, and print may stand on two sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.cameras import Camera, to_matrix
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.transforms import transform_camera
from zeroshop_steps.join.pass_images import Pass
from zeroshop_steps.join.ways import Way
from zeroshop_steps.register.group_likeness import Likeness, compare_groups
from zeroshop_steps.register.group_similarity import CameraGroup

LARGEST_MISS_PX = 2.5
"""By how much rays through the rims may miss the masks of the other pass in the mean, per 1000 px: exact masks miss by 0.1, found ones
by up to 2."""
SURE_PAIRS = 40  # of points that match: so many say that pictures show the same, where too few patches could be compared


@dataclass(frozen=True)
class Judgement:
    """How well a way fits.

    Attributes:
        way: the way.
        miss_px: by how much the rays of each pass miss the masks of the other in the mean, px per 1000 px of the image.
        likeness: how far pictures of both passes show the same.
    """

    way: Way
    miss_px: float
    likeness: Likeness

    @property
    def verdict(self) -> str:
        """`right`, `wrong`, or `open`: it fits, but nothing shows that it is right."""
        if self.miss_px > LARGEST_MISS_PX or self.likeness.different:
            return "wrong"
        return "right" if self.likeness.same or self.way.pairs >= SURE_PAIRS else "open"

    def figures(self) -> dict[str, Any]:
        """For the record."""
        return {"verdict": self.verdict, "point_pairs": self.way.pairs, "miss_px": round(self.miss_px, 3), **self.likeness.figures()}


def judge(way: Way, target: list[View], source: list[View], groups: tuple[CameraGroup, CameraGroup]) -> Judgement:
    """Judge a way by the views of both passes, each in its own frame, and their outlines."""
    first, second = groups
    misses = [second.measure_misses(first, way.target_from_source), first.measure_misses(second, np.linalg.inv(way.target_from_source))]
    moved = [View(transform_camera(view.camera, way.target_from_source), view.image_path, view.mask_path) for view in source]
    likeness = compare_groups([*target, *moved], {view.camera.name for view in source})
    return Judgement(way, float(np.concatenate(misses).mean()), likeness)


def make_views(one: Pass) -> list[View]:
    """The views of a pass in its own frame, sorted by name."""
    views = []
    for image in sorted(one.model.images.values(), key=lambda image: image.name):
        if image.has_pose:
            lens = one.model.cameras[image.camera_id]
            camera = Camera(image.name, lens.width, lens.height, np.array(lens.calibration_matrix()), to_matrix(image.cam_from_world()))
            views.append(View(camera, Path(one.images[image.name]), Path(one.masks[image.name])))
    return views


def make_group(views: Sequence[View]) -> CameraGroup:
    """The outlines of a pass."""
    return CameraGroup([view.camera for view in views], {view.camera.name: view.mask() for view in views})
