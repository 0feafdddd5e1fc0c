"""Grasps for an object that lies on a table just so.

The grasps of a file come from a few directions each. Where the object really lies, one that is nearly right can be made right: kept
back along its approach, so that the contacts are nearer to the fingertips, turned about its closing axis, or levelled, so that it comes
straight from above. The contacts stay where they are, and so do robustness and balance; room and what touches are judged again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.support.placements import Placement
from zeroshop_steps.grasp.antipodal import OBJECT_MARGIN_M, SHALLOWEST_M, TABLE_MARGIN_M, opening_for
from zeroshop_steps.grasp.clearance import check_object, check_table
from zeroshop_steps.grasp.grasps import Grasp
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.grasp.ranking import combine, fit_of

MARGINS_M = ((SHALLOWEST_M, TABLE_MARGIN_M), (0.003, 0.002))
"""Of the contacts from the fingertips, and of the gripper from the table. The second ones count only where the first leave no grasp:
what is less than 18 mm thick can be taken from the table by no others."""
MOST_TURN_RAD = np.radians(22.5)  # as far as two directions that `antipodal` tries lie apart


@dataclass(frozen=True)
class AdaptedGrasp:
    """A grasp where the object lies.

    Attributes:
        world_from_gripper: (4, 4) m, when the fingers close.
        opening_m: between the pads on the approach.
        score: 0..1, as in the file, with what the adapted gripper touches.
    """

    world_from_gripper: np.ndarray
    opening_m: float
    score: float


def best_above_table(
    grasps: Sequence[Grasp], points: np.ndarray, world_from_object: np.ndarray, gripper: Gripper, friction: float
) -> AdaptedGrasp | None:
    """The best grasp that keeps clear of the table and the object; None if there is none.

    Args:
        grasps: in the object's frame.
        points: (P, 3) dense points of the object's whole surface, metres, its frame.
        world_from_object: (4, 4) m, where the object is believed to lie; the table's top is z = 0.
        gripper: that the grasps are for.
        friction: coefficient that the grasps were found with.
    """
    if not grasps:
        return None
    for shallowest_m, table_margin_m in MARGINS_M:
        tried = _variants(grasps, world_from_object[2, :3], gripper, np.arctan(friction), shallowest_m)
        openings = opening_for(tried.width_m, gripper)
        above = check_table([Placement(world_from_object, 1.0, 0.0)], tried.poses, openings, gripper, table_margin_m)[:, 0]
        tried, openings = tried.at(above), openings[above]
        pads = check_object(points, tried.poses, tried.width_m, openings, gripper, OBJECT_MARGIN_M)
        scores = combine({**tried.measures, "fit": fit_of(pads.excess_m), "touching": pads.touching})
        if pads.free.any():
            best = int(np.where(pads.free, scores, -1.0).argmax())
            return AdaptedGrasp(world_from_object @ tried.poses[best], float(openings[best]), float(scores[best]))
    return None


@dataclass(frozen=True)
class _Variants:
    """(N, 4, 4) object_from_gripper, (N,) widths, and (N,) of each measure that the contacts alone decide."""

    poses: np.ndarray
    width_m: np.ndarray
    measures: dict[str, np.ndarray]

    def at(self, index: np.ndarray) -> "_Variants":
        return _Variants(self.poses[index], self.width_m[index], {name: values[index] for name, values in self.measures.items()})


def _variants(grasps: Sequence[Grasp], up: np.ndarray, gripper: Gripper, cone_rad: float, shallowest_m: float) -> _Variants:
    """Every grasp as it is, turned and levelled, and each of these kept back by several distances.

    Args:
        up: (3,) the table's normal in the object's frame.
        cone_rad: half the friction cone's angle.
    """
    given = np.stack([grasp.object_from_gripper for grasp in grasps])
    contact_z = np.array([grasp.contact_m for grasp in grasps])
    widths = np.array([grasp.width_m for grasp in grasps])
    friction, robustness, balance = (np.array([grasp.measures[name] for grasp in grasps]) for name in ("friction", "robustness", "balance"))
    contacts = given[:, :3, 3] + contact_z[:, None] * given[:, :3, 2]
    approach, closing = given[:, :3, 2], given[:, :3, 1]
    turned = _turned_down(approach, closing, up)
    level = closing - (closing @ up)[:, None] * up
    tilt = np.arcsin(np.clip(np.abs(closing @ up), 0, 1))
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-9)
    straight = np.broadcast_to(-up, level.shape)
    kept: list[_Variants] = []
    for toward, along, lost in ((approach, closing, 0.0 * tilt), (turned, closing, 0.0 * tilt), (straight, level, tilt / cone_rad)):
        for back_m in (0.0, 0.004, 0.008, 0.012):
            possible = (friction > lost) & ((contact_z + back_m <= gripper.tip_m - shallowest_m) | (back_m == 0.0))
            poses = np.tile(np.eye(4), (len(grasps), 1, 1))
            poses[:, :3, :3] = np.stack([np.cross(along, toward), along, toward], 2)
            poses[:, :3, 3] = contacts - (contact_z + back_m)[:, None] * toward
            measures = {"friction": friction - lost, "robustness": robustness, "balance": balance}
            kept.append(_Variants(poses, widths, measures).at(possible))
    measures = {name: np.concatenate([one.measures[name] for one in kept]) for name in kept[0].measures}
    return _Variants(np.concatenate([one.poses for one in kept]), np.concatenate([one.width_m for one in kept]), measures)


def _turned_down(approach: np.ndarray, closing: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(N, 3) approaches turned about the closing axes, by `MOST_TURN_RAD` at most, to come from above."""
    aside = np.cross(closing, approach)
    angle = np.clip(np.arctan2(-aside @ up, -approach @ up), -MOST_TURN_RAD, MOST_TURN_RAD)[:, None]
    return np.cos(angle) * approach + np.sin(angle) * aside
