"""The robot: it looks, finds the object that it was asked for, and plans how to take it. It knows its own meshes alone."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.grasp.adapting import AdaptedGrasp, best_above_table
from zeroshop_steps.grasp.antipodal import FoundGrasps
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.simulate.camera import SensedFrame
from zeroshop_steps.simulate.perception import Perception, Sighting
from zeroshop_steps.simulate.true_object import in_metres

UNSEEN, UNPLACED, UNREACHABLE = "detect", "pose", "choose"
"""Where a plan can end: the object was not detected, too little of it was measured, no grasp is clear of the table."""


MOST_LIFT_M = 0.02  # a pose is that much too high or too low at most, if the object stands on the table


@dataclass(frozen=True)
class Plan:
    """What the robot makes of an image.

    Attributes:
        sighting: of the object; None where it was not detected.
        grasp: None where the plan ended before.
        result: one of UNSEEN, UNPLACED, UNREACHABLE; None where there is a grasp.
    """

    sighting: Sighting | None
    grasp: AdaptedGrasp | None
    result: str | None


@dataclass(frozen=True)
class Robot:
    """What the robot knows and has.

    Attributes:
        perception: with its meshes.
        object_id: what it is asked for.
        known: the grasps and the surface of that object's mesh.
        gripper: its hand.
    """

    perception: Perception
    object_id: int
    known: FoundGrasps
    gripper: Gripper

    def plan(self, frame: SensedFrame) -> Plan:
        """What to do with the object; the camera's place above the table is known."""
        sighting = self.perception.find(frame, self.object_id, self.perception.detect(frame))
        if sighting is None:
            return Plan(None, None, UNSEEN)
        if sighting.camera_from_model is None:
            return Plan(sighting, None, UNPLACED)
        world_from_model = np.linalg.inv(frame.camera_from_table) @ sighting.camera_from_model
        resting = put_on_table(in_metres(world_from_model), self.known.points)
        grasp = best_above_table(self.known.grasps, self.known.points, resting, self.gripper, self.known.friction)
        return Plan(sighting, grasp, None if grasp else UNREACHABLE)


def put_on_table(world_from_model: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A pose, (4, 4) in metres, moved up or down so that the lowest of (P, 3) points is on the table, z = 0.

    What is estimated farther from it than `MOST_LIFT_M` does not stand on the table, or not in this pose; it stays.
    """
    lowest = float((points @ world_from_model[2, :3]).min() + world_from_model[2, 3])
    resting = world_from_model.copy()
    resting[2, 3] -= lowest if abs(lowest) < MOST_LIFT_M else 0.0
    return resting
