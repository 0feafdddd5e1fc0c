"""The thesis's eight poses of an object (4.4.3): upright, turned four times by 90 degrees, and flipped, or on its side, the same."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.geometry.support.placements import LEAST_STABILITY_DEG, Placement, placements_of_hull
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody

FACING_ROBOT_DEG = 180.0  # the robot looks along +x of the table, and at 0 degrees the object's front, its x axis, faces it


@dataclass(frozen=True)
class ProtocolPose:
    """One of the eight.

    Attributes:
        number: 1 to 8.
        placement: `upright`, `flipped` or `lying`.
        turn_deg: about the vertical.
        world_from_object: (4, 4) m, before the object settles.
    """

    number: int
    placement: str
    turn_deg: float
    world_from_object: np.ndarray


def choose_poses(body: PhysicalBody, name: str) -> list[ProtocolPose]:
    """The eight poses of a body.

    An object that cannot stand upright starts in its likeliest placement; one that cannot be flipped lies in the likeliest other one.

    Raises:
        StepError: it has no two stable placements.
    """
    placements = placements_of_hull(body.corners, body.centre_m)
    possible = [one for one in placements if one.kind == "lying" or one.stability_deg >= LEAST_STABILITY_DEG]
    first = _first_of_kind(possible, "upright") or (possible[0] if possible else None)
    others = [one for one in possible if one is not first]
    second = _first_of_kind(others, "flipped") or _first_of_kind(others, "lying") or (others[0] if others else None)
    if first is None or second is None:
        raise StepError(f"{name} rests on a table in fewer than two ways; the eight poses need two")
    turned = [(one, turn) for one in (first, second) for turn in (0.0, 90.0, 180.0, 270.0)]
    return [ProtocolPose(number, one.kind, turn, _turn(one, turn)) for number, (one, turn) in enumerate(turned, 1)]


def _first_of_kind(placements: list[Placement], kind: str) -> Placement | None:
    return next((one for one in placements if one.kind == kind), None)


def _turn(placement: Placement, turn_deg: float) -> np.ndarray:
    turn = Rotation.from_euler("z", FACING_ROBOT_DEG + turn_deg, degrees=True).as_matrix()
    # A millimetre above the table, from which it is let go.
    return make_transform(turn, [0.0, 0.0, 0.001]) @ placement.plane_from_object
