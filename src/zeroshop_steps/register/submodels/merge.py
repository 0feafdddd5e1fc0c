"""Join groups of cameras that no matches hold together, by the object's outlines and its pictures.

An object may be matched from front and from back, but not over its plain sides. Its outlines say how the groups lie to each other
(`alignment`), often up to a half turn; then views of both groups that look from nearly one side must show the same. Exactly one way
must pass, and each other way that fits the outlines must be seen to be wrong, else nothing is joined: objects of revolution and boxes
without print stay apart.
"""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import make_transform, to_rigid
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.transforms import compute_scale, transform_points
from zeroshop_steps.register.mapping.reregistration import refine_robustly
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.undistortion import undistort, undistort_masks
from zeroshop_steps.register.silhouettes.model_adjustment import adjust_model_by_silhouettes
from zeroshop_steps.register.silhouettes.pose_fit import FINE_MISS_PX, WRONG_MISS_PX
from zeroshop_steps.register.submodels.appearance import Likeness, compare_groups
from zeroshop_steps.register.submodels.outline_alignment import CameraGroup, find_hypotheses
from zeroshop_steps.runtime.files import scratch_directory

LEAST_IMAGES = 5  # of a group
ROUGH_MISS_PX = 3.0  # beyond it, no way is adjusted and judged


class Verdict(StrEnum):
    """Of a way to lay a submodel to another."""

    SAME = "same"
    OPEN = "open"
    DIFFERENT = "different"


@dataclass(frozen=True)
class MergedModel:
    """Two submodels, laid to each other in one way.

    Attributes:
        model: both, adjusted by outlines.
        miss_px: by how much rays through rims then miss, in the mean, per 1000 px of the image.
        alike: how well views of the one and of the other show the same.
    """

    model: pycolmap.Reconstruction
    miss_px: float
    alike: Likeness

    @property
    def verdict(self) -> Verdict:
        """Whether this is how they lie."""
        if self.miss_px > WRONG_MISS_PX or self.alike.different:
            return Verdict.DIFFERENT
        return Verdict.SAME if self.miss_px <= FINE_MISS_PX and self.alike.same else Verdict.OPEN

    def figures(self) -> dict[str, Any]:
        """For the record."""
        return {"miss_px": self.miss_px, **self.alike.figures(), "verdict": self.verdict}


def merge_submodels(
    models: list[pycolmap.Reconstruction], image_set: ImageSet, scratch: Path
) -> tuple[pycolmap.Reconstruction | None, list[dict[str, Any]]]:
    """One model of all groups that can be joined to the largest, adjusted by outlines; None where none can.

    Args:
        models: the groups; those of fewer than `LEAST_IMAGES` images are left out.
        image_set: the images, with masks.
        scratch: folder for what is written on the way.

    Returns:
        The model, and for the record what was tried: images of both groups, and what each way gave.
    """
    groups = sorted((model for model in models if model.num_reg_images() >= LEAST_IMAGES), key=lambda model: -model.num_reg_images())
    tried: list[dict[str, Any]] = []
    if len(groups) < 2:
        return None, tried
    for group in groups:
        refine_robustly(group)
    whole, joined = groups[0], False
    for group in groups[1:]:
        ways = _judge_ways(whole, group, image_set, scratch)
        right = [way.model for way in ways if way.verdict is Verdict.SAME]
        open_ways = sum(way.verdict is Verdict.OPEN for way in ways)
        tried.append({"images": [whole.num_reg_images(), group.num_reg_images()], "ways": [way.figures() for way in ways]})
        if len(right) == 1 and not open_ways:
            whole, joined = right[0], True
    return (whole if joined else None), tried


def _judge_ways(target: pycolmap.Reconstruction, source: pycolmap.Reconstruction, image_set: ImageSet, scratch: Path) -> list[MergedModel]:
    """The likeliest ways to lay one group to the other."""
    ways = []
    for hypothesis in find_hypotheses(*(CameraGroup(*undistort_masks(model, image_set)) for model in (target, source))):
        if hypothesis.miss_px > ROUGH_MISS_PX:
            continue
        merged, added = merge_models(target, source, hypothesis.target_from_source)
        adjusted = adjust_model_by_silhouettes(merged, image_set)
        with scratch_directory(scratch / "joined", "views") as folder:
            undistort(adjusted.model, image_set, folder)
            alike = compare_groups(read_views(folder)[0], added)
        ways.append(MergedModel(adjusted.model, adjusted.missed_px[1], alike))
    return ways


def merge_models(
    target: pycolmap.Reconstruction, source: pycolmap.Reconstruction, target_from_source: np.ndarray
) -> tuple[pycolmap.Reconstruction, set[str]]:
    """A copy of `target` with the images that only `source` has, and its points there; the names of these images.

    Lenses are the target's. Both models come from one database.
    """
    merged = pycolmap.Reconstruction(target)
    rotation = target_from_source[:3, :3] / compute_scale(target_from_source)
    own = set()
    for image_id in sorted(source.reg_image_ids()):
        image = source.images[image_id]
        if image_id in merged.images and merged.images[image_id].has_pose:
            continue
        turned = image.cam_from_world().rotation.matrix() @ rotation.T
        pose = make_transform(turned, -turned @ transform_points(image.projection_center()[None], target_from_source)[0])
        if image_id in merged.images:
            merged.frames[image.frame_id].set_cam_from_world(image.camera_id, to_rigid(pose))
            merged.register_frame(image.frame_id)
        else:
            bare = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image_id)
            bare.points2D = [pycolmap.Point2D(point.xy) for point in image.points2D]
            merged.add_image_with_trivial_frame(bare, to_rigid(pose))
        own.add(image_id)
    for point_id in sorted(source.point3D_ids()):
        track = pycolmap.Track()
        for element in source.points3D[point_id].track.elements:
            if element.image_id in own:
                track.add_element(element.image_id, element.point2D_idx)
        if track.length() > 1:  # two rays make a point
            merged.add_point3D(transform_points(source.points3D[point_id].xyz[None], target_from_source)[0], track)
    return merged, {source.images[image_id].name for image_id in own}
