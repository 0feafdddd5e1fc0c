"""From an image to the pose of the object that is asked for: our detector and pose estimator, as the servers of a robot call them."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.models import ObjectModel, list_objects, read_models
from zeroshop_steps.detect import contour
from zeroshop_steps.detect.detector_io import ObjectMask
from zeroshop_steps.detect.joined import join_touching
from zeroshop_steps.detect.templates import read_templates
from zeroshop_steps.pose.confidence import SURE_CONFIDENCE, estimate_confidence
from zeroshop_steps.pose.render_compare import SPARE_DETECTIONS, PreparedModel, estimate_pose
from zeroshop_steps.simulate.camera import SensedFrame


@dataclass(frozen=True)
class Sighting:
    """What the robot believes of the object that it was asked for.

    Attributes:
        mask: (height, width) bool.
        score: of the detection, 0..1.
        camera_from_model: (4, 4) mm, of the mesh that the robot knows; None where no pose fits.
        confidence: of the pose, 0..1.
    """

    mask: np.ndarray
    score: float
    camera_from_model: np.ndarray | None
    confidence: float


class Perception:
    """Finds the objects of a folder of models. Poses are estimated as in `pose`: of the surest detection and a few more.

    Where none of these poses is sure, the detections may be parts of the object, and those that touch are tried as one.
    """

    def __init__(self, models: Path, templates: Path) -> None:
        """From a folder of models in BOP's layout and that of their 42 views."""
        self.models: Mapping[int, ObjectModel] = read_models(models, list_objects(models))
        self._detect = contour.prepare(argparse.Namespace(), dict(self.models), lambda number: read_templates(templates, number))
        self._ready: dict[int, PreparedModel] = {}

    def detect(self, frame: SensedFrame) -> list[ObjectMask]:
        """All objects in an image, the surest first."""
        return sorted(self._detect(frame), key=lambda one: -one.score)

    def find(self, frame: SensedFrame, object_id: int, found: list[ObjectMask]) -> Sighting | None:
        """The object that is asked for, by its surest pose among the detections `found`; None where it was not detected."""
        mine = [one for one in found if one.object_id == object_id][: 1 + SPARE_DETECTIONS]
        sightings = [self._locate(frame, one) for one in mine]
        if sightings and max(one.confidence for one in sightings) < SURE_CONFIDENCE:
            whole = join_touching([one.mask for one in mine])
            sightings += [self._locate(frame, ObjectMask(object_id, mine[0].score, mask)) for mask in whole]
        return max(sightings, key=lambda one: one.confidence, default=None)

    def _locate(self, frame: SensedFrame, one: ObjectMask) -> Sighting:
        ready = self._ready.get(one.object_id) or PreparedModel(self.models[one.object_id])
        self._ready[one.object_id] = ready
        pose = estimate_pose(one.mask, frame.photo, frame.depth_mm(), frame.intrinsics, ready)
        if pose is None:
            return Sighting(one.mask, one.score, None, 0.0)
        return Sighting(one.mask, one.score, pose.camera_from_model, estimate_confidence(pose.explained, pose.margin, pose.points))
