"""Where an arm can bring the camera on its hand: postures by inverse kinematics, and ways between them that are clear."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.scan.arm.inverse_kinematics import nearest_turns, solve_poses
from zeroshop_steps.scan.arm.kinematics import JOINTS, Arm, Capsule
from zeroshop_steps.scan.reach import Move
from zeroshop_steps.scan.workspace import Box

POINT_GAP_M = 0.025  # of the points on a capsule's middle line: less than the radius of any link
CLEARANCE_M = 0.01  # that the body keeps from everything: servos, calibration and the capsules' shape are off by less
PATH_STEP_RAD = 0.02  # of the joint that turns most, between postures that are looked at: 2 cm at an arm's length of 1 m
MOVING_FROM = 2  # parts of frames before this stand on the table
MEETING = 2  # parts whose frames are so many joints apart, or fewer, meet at a joint and are not compared
ROLLS_RAD = (0.0, np.pi)
"""Of the camera about its axis. A photo that is upside down is turned when it is recorded; one on its side would have another shape."""
STARTS = 12  # of the inverse kinematics for each pose


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
        placed, clear = self._place(joints_rad)
        for row in np.flatnonzero(clear):
            clear[row] = self._is_apart(placed[row])
        return clear

    def is_path_clear(self, start_rad: np.ndarray, end_rad: np.ndarray) -> bool:
        """Whether all postures between two are clear when all joints move evenly."""
        count = max(2, int(np.ceil(np.abs(end_rad - start_rad).max() / PATH_STEP_RAD)) + 1)
        shares = np.linspace(0.0, 1.0, count)[:, None]
        placed, clear = self._place(start_rad + shares * (end_rad - start_rad))
        return bool(clear.all()) and all(map(self._is_apart, placed))

    def _place(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, P, 3) points of the body in (N, 6) postures, and (N,) bool: the postures clear of the table and of what is kept out."""
        points, frames, radii = self._body_points
        base_from_frame = self.arm.find_frames(joints_rad)[:, frames]
        placed = np.einsum("npij,pj->npi", base_from_frame[..., :3, :3], points) + base_from_frame[..., :3, 3]
        moving = frames >= MOVING_FROM
        room = radii + CLEARANCE_M
        clear = (placed[:, moving, 2] > self.table_m + room[moving]).all(1)
        if self.keep_out is not None:
            clear &= (self.keep_out.distance_m(placed[:, moving]) > room[moving]).all(1)
        return placed, np.asarray(clear)

    def _is_apart(self, points: np.ndarray) -> bool:
        """Whether no part of the body is near another, by its (P, 3) points."""
        first, second, least_squared = self._pairs
        between = points[first] - points[second]
        return bool((np.einsum("pi,pi->p", between, between) > least_squared).all())

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points that are compared, and the squares of their least distances: parts that meet at a joint overlap there by their shape."""
        _, frames, radii = self._body_points
        first, second = np.nonzero(np.triu(np.abs(frames[:, None] - frames) > MEETING))
        return first, second, (radii[first] + radii[second] + CLEARANCE_M) ** 2

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


@dataclass(frozen=True)
class CameraHand:
    """What the flange carries.

    Attributes:
        flange_from_camera: (4, 4) m; the camera has OpenCV's axes.
        body: capsules in the flange's frame.
    """

    flange_from_camera: np.ndarray
    body: tuple[Capsule, ...] = ()


@dataclass
class ArmReach:
    """An arm that stands somewhere, and its posture now.

    Attributes:
        arm, hand: what moves.
        world_from_base: (4, 4) m; the base is upright.
        table_m: height of the table's top in the world.
        keep_out: box around the object, in the world.
        joints_rad: (6,) the posture now; whoever moves the arm sets it.
    """

    arm: Arm
    hand: CameraHand
    world_from_base: np.ndarray
    table_m: float
    keep_out: Box | None
    joints_rad: np.ndarray = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        self._base_from_world = np.linalg.inv(self.world_from_base)
        boxed = None if self.keep_out is None else self.keep_out.moved(self._base_from_world)
        self.check = ClearanceCheck(self.arm, self.hand.body, self.table_m - float(self.world_from_base[2, 3]), boxed)
        self._known: dict[bytes, list[np.ndarray]] = {}

    def find_camera(self, joints_rad: np.ndarray) -> np.ndarray:
        """(4, 4) world_from_camera of a posture."""
        return np.asarray(self.world_from_base @ self.arm.find_flange(joints_rad) @ self.hand.flange_from_camera)

    def plan(self, world_from_cameras: np.ndarray) -> list[Move | None]:
        """The quickest clear way to each view, by whichever roll of the camera and posture."""
        return [self._plan_one(view, postures) for view, postures in zip(world_from_cameras, self.solve(world_from_cameras), strict=True)]

    def solve(self, world_from_cameras: np.ndarray) -> list[list[np.ndarray]]:
        """For each view and each of `ROLLS_RAD`, the (S, 6) clear postures; they do not depend on the posture now."""
        keys = [np.round(view, 5).tobytes() for view in world_from_cameras]
        missing = [index for index, key in enumerate(keys) if key not in self._known]
        if missing:
            rolls = np.tile(np.eye(4), (len(ROLLS_RAD), 1, 1))
            rolls[:, :3, :3] = Rotation.from_rotvec(np.outer(ROLLS_RAD, [0.0, 0.0, 1.0])).as_matrix()
            flange_from_camera = np.linalg.inv(self.hand.flange_from_camera)
            wanted = self._base_from_world @ world_from_cameras[missing][:, None] @ rolls @ flange_from_camera
            found = solve_poses(self.arm, wanted.reshape(-1, 4, 4), STARTS, np.random.default_rng(0))
            clear = [postures[self.check.is_clear(postures)] if len(postures) else postures for postures in found]
            for place, index in enumerate(missing):
                self._known[keys[index]] = clear[place * len(ROLLS_RAD) : (place + 1) * len(ROLLS_RAD)]
        return [self._known[key] for key in keys]

    def _plan_one(self, world_from_camera: np.ndarray, postures_of_rolls: list[np.ndarray]) -> Move | None:
        postures = np.concatenate([nearest_turns(self.arm, found, self.joints_rad) for found in postures_of_rolls])
        if not len(postures):
            return None
        home = nearest_turns(self.arm, np.array(self.arm.home_rad)[None], self.joints_rad)[0]
        seconds = self.arm.seconds_between(self.joints_rad, postures)
        for index in np.argsort(seconds):
            if self.check.is_path_clear(self.joints_rad, postures[index]):
                return self._move(postures[index], (postures[index],), float(seconds[index]))
        if not self.check.is_path_clear(self.joints_rad, home):
            return None
        ends = nearest_turns(self.arm, postures, home)
        seconds = self.arm.seconds_between(home, ends)
        for index in np.argsort(seconds):
            if self.check.is_path_clear(home, ends[index]):
                to_home = float(self.arm.seconds_between(self.joints_rad, home[None])[0])
                return self._move(ends[index], (home, ends[index]), to_home + float(seconds[index]))
        return None

    def _move(self, joints_rad: np.ndarray, waypoints: tuple[np.ndarray, ...], seconds: float) -> Move:
        return Move(self.find_camera(joints_rad), seconds, waypoints)
