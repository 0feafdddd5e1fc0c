"""Whether an arm touches the table, the space that is kept out of, or itself: capsules as points on their middle lines."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeroshop_steps.scan.arm.kinematics import JOINTS, Arm, Capsule
from zeroshop_steps.scan.workspace import Box

POINT_GAP_M = 0.025  # of the points on a capsule's middle line: less than the radius of any link
CLEARANCE_M = 0.01  # that the body keeps from everything: servos, calibration and the capsules' shape are off by less
PATH_STEP_RAD = 0.02  # of the joint that turns most, between postures that are looked at: 2 cm at an arm's length of 1 m
MOVING_FROM = 2  # parts of frames before this stand on the table
MEETING = 2  # parts whose frames are so many joints apart, or fewer, meet at a joint and are not compared


@dataclass(frozen=True)
class ClearanceCheck:
    """What a posture is checked against.

    Attributes:
        arm: the arm.
        hand: what it carries, capsules in the flange's frame (number 6).
        table_m: height of the table's top in the arm's base frame.
        keep_out: in the same frame, what no part may enter.
    """

    arm: Arm
    hand: tuple[Capsule, ...]
    table_m: float
    keep_out: Box | None

    def is_clear(self, joints_rad: np.ndarray) -> np.ndarray:
        """(N,) bool of (N, 6) joint angles."""
        points, frames, radii = self._body_points
        base_from_frame = self.arm.find_frames(joints_rad)[:, frames]
        placed = np.einsum("npij,pj->npi", base_from_frame[..., :3, :3], points) + base_from_frame[..., :3, 3]
        moving = frames >= MOVING_FROM
        room = radii + CLEARANCE_M
        clear = (placed[:, moving, 2] > self.table_m + room[moving]).all(1)
        if self.keep_out is not None:
            clear &= (self.keep_out.distance_m(placed[:, moving]) > room[moving]).all(1)
        rows = np.flatnonzero(clear)
        first, second = self._pairs
        for row in rows:
            apart = np.linalg.norm(placed[row, first] - placed[row, second], axis=1)
            clear[row] = bool((apart > radii[first] + radii[second] + CLEARANCE_M).all())
        return np.asarray(clear)

    def is_path_clear(self, start_rad: np.ndarray, end_rad: np.ndarray) -> bool:
        """Whether all postures between two are clear when all joints move evenly."""
        count = max(2, int(np.ceil(np.abs(end_rad - start_rad).max() / PATH_STEP_RAD)) + 1)
        shares = np.linspace(0.0, 1.0, count)[:, None]
        return bool(self.is_clear(start_rad + shares * (end_rad - start_rad)).all())

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Points that are compared: parts that meet at a joint overlap there by their shape."""
        _, frames, _ = self._body_points
        first, second = np.nonzero(np.triu(np.abs(frames[:, None] - frames) > MEETING))
        return first, second

    @cached_property
    def _body_points(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(P, 3) points in their frames, (P,) frames, and (P,) radii."""
        points, frames, radii = [], [], []
        for part in (*self.arm.capsules, *self.hand):
            start, end = np.array(part.start_m), np.array(part.end_m)
            count = max(2, int(np.ceil(np.linalg.norm(end - start) / POINT_GAP_M)) + 1)
            points.append(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))
            frames += [min(part.frame, JOINTS)] * count
            radii += [part.radius_m] * count
        return np.concatenate(points), np.array(frames), np.array(radii)
