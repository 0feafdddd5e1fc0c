"""Which grasp the robot takes: the best of those for which the table leaves room where it believes that the object lies."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.placements import Placement
from zeroshop_steps.grasp.antipodal import TABLE_MARGIN_M, opening_for
from zeroshop_steps.grasp.clearance import check_table
from zeroshop_steps.grasp.grasps import Grasp
from zeroshop_steps.grasp.gripper import Gripper


@dataclass(frozen=True)
class ChosenGrasp:
    """What the gripper is told to do.

    Attributes:
        world_from_gripper: (4, 4) m, when it closes.
        opening_m: between the pads on the approach.
        score: of the grasp, 0..1.
    """

    world_from_gripper: np.ndarray
    opening_m: float
    score: float


def choose_grasp(grasps: Sequence[Grasp], world_from_object: np.ndarray, gripper: Gripper) -> ChosenGrasp | None:
    """The best grasp that keeps clear of the table; None if there is none.

    Args:
        grasps: the best first, in the object's frame.
        world_from_object: (4, 4) m, where the robot believes that the object is; the table's top is z = 0.
        gripper: that the grasps are for.
    """
    if not grasps:
        return None
    poses = np.stack([grasp.object_from_gripper for grasp in grasps])
    openings = opening_for(np.array([grasp.width_m for grasp in grasps]), gripper)
    free = check_table([Placement(world_from_object, 1.0, 0.0)], poses, openings, gripper, TABLE_MARGIN_M)[:, 0]
    if not free.any():
        return None
    best = int(np.argmax(free))
    return ChosenGrasp(world_from_object @ poses[best], float(openings[best]), grasps[best].score)
