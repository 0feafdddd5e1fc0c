"""The robot: it looks, finds the object that it was asked for, and plans how to take it. It knows its own meshes alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.grasp.grasps import Grasp
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.simulate.camera import SensedFrame
from zeroshop_steps.simulate.grasp_choice import ChosenGrasp, choose_grasp
from zeroshop_steps.simulate.perception import Perception, Sighting
from zeroshop_steps.simulate.true_object import in_metres

UNSEEN, UNPLACED, UNREACHABLE = "detect", "pose", "choose"
"""Where a plan can end: the object was not detected, too little of it was measured, no grasp is clear of the table."""


@dataclass(frozen=True)
class Plan:
    """What the robot makes of an image.

    Attributes:
        sighting: of the object; None where it was not detected.
        grasp: None where the plan ended before.
        result: one of UNSEEN, UNPLACED, UNREACHABLE; None where there is a grasp.
    """

    sighting: Sighting | None
    grasp: ChosenGrasp | None
    result: str | None


@dataclass(frozen=True)
class Robot:
    """What the robot knows and has.

    Attributes:
        perception: with its meshes.
        object_id: what it is asked for.
        grasps: of that object's mesh, the best first.
        gripper: its hand.
    """

    perception: Perception
    object_id: int
    grasps: Sequence[Grasp]
    gripper: Gripper

    def plan(self, frame: SensedFrame) -> Plan:
        """What to do with the object; the camera's place above the table is known."""
        sighting = self.perception.find(frame, self.object_id, self.perception.detect(frame))
        if sighting is None:
            return Plan(None, None, UNSEEN)
        if sighting.camera_from_model is None:
            return Plan(sighting, None, UNPLACED)
        world_from_model = np.linalg.inv(frame.camera_from_table) @ sighting.camera_from_model
        grasp = choose_grasp(self.grasps, in_metres(world_from_model), self.gripper)
        return Plan(sighting, grasp, None if grasp else UNREACHABLE)
