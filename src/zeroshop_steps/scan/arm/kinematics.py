"""Arms of six hinge joints by their Denavit-Hartenberg parameters (1955, the distal convention): where the flange is, and how it moves.

Frame i follows frame i-1 by a turn about z (the joint), a shift d along z, a shift a along the new x, and a turn alpha about it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeroshop_steps.runtime.errors import StepError

JOINTS = 6


@dataclass(frozen=True)
class Capsule:
    """A part of an arm's body: all that is nearer than a radius to a segment.

    Attributes:
        frame: the DH frame that it is fixed to; 0 is the base.
        start_m, end_m: (3,) of the segment, in that frame.
        radius_m: around it.
    """

    frame: int
    start_m: tuple[float, ...]
    end_m: tuple[float, ...]
    radius_m: float


@dataclass(frozen=True)
class Arm:
    """An arm of six joints. Metres and radians; all tuples have an entry a joint.

    Attributes:
        name: how options call it.
        a_m, d_m, alpha_rad: Denavit-Hartenberg parameters.
        low_rad, high_rad: limits of the joints.
        speed_rad_s: greatest speed of each joint.
        radius_m: of the link behind each joint.
        shift_m: how far the middle of that link's tube lies along its joint's axis, beside the DH frame's x axis.
        home_rad: a posture clear of the table, from which others are reached.
    """

    name: str
    a_m: tuple[float, ...]
    d_m: tuple[float, ...]
    alpha_rad: tuple[float, ...]
    low_rad: tuple[float, ...]
    high_rad: tuple[float, ...]
    speed_rad_s: tuple[float, ...]
    radius_m: tuple[float, ...]
    shift_m: tuple[float, ...]
    home_rad: tuple[float, ...]

    @cached_property
    def fixed_steps(self) -> np.ndarray:
        """(6, 4, 4) what follows the turn of each joint: the shifts along z and x and the turn about x."""
        steps = np.zeros((JOINTS, 4, 4))
        for step, a, d, alpha in zip(steps, self.a_m, self.d_m, self.alpha_rad, strict=True):
            cos, sin = np.cos(alpha), np.sin(alpha)
            step[:] = [[1, 0, 0, a], [0, cos, -sin, 0], [0, sin, cos, d], [0, 0, 0, 1]]
        return steps

    @cached_property
    def capsules(self) -> tuple[Capsule, ...]:
        """The body: for each link a tube along its d and its a, where these are not 0."""
        found = []
        for joint in range(JOINTS):
            joint_from_end = self.fixed_steps[joint]
            a, d, shift = self.a_m[joint], self.d_m[joint], self.shift_m[joint]
            corner, beside = [0.0, 0.0, d], [0.0, 0.0, d + shift]
            segments = [([0.0, 0.0, 0.0], corner)] if d else []
            segments += [(beside, [a, 0.0, d + shift])] if a else []
            segments += [(corner, beside)] if shift else []
            for segment in segments:
                ends = (np.array(segment) - joint_from_end[:3, 3]) @ joint_from_end[:3, :3]
                # The first link is a column that does not turn visibly: it belongs to the base.
                frame, (start, end) = (joint + 1, ends.tolist()) if joint else (0, segment)
                found.append(Capsule(frame, tuple(start), tuple(end), self.radius_m[joint]))
        return tuple(found)

    def within_limits(self, joints_rad: np.ndarray) -> np.ndarray:
        """(N,) bool of (N, 6) joint angles."""
        return np.asarray(((joints_rad >= self.low_rad) & (joints_rad <= self.high_rad)).all(-1))

    def find_frames(self, joints_rad: np.ndarray) -> np.ndarray:
        """(N, 7, 4, 4) base_from_frame of the base and of the frame behind each joint, for (N, 6) joint angles; the last is the flange."""
        joints_rad = np.asarray(joints_rad, float)
        frames = np.empty((len(joints_rad), JOINTS + 1, 4, 4))
        frames[:, 0] = np.eye(4)
        turn = np.zeros((len(joints_rad), 4, 4))
        turn[:, 2, 2] = turn[:, 3, 3] = 1.0
        for joint in range(JOINTS):
            cos, sin = np.cos(joints_rad[:, joint]), np.sin(joints_rad[:, joint])
            turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cos, -sin, sin, cos
            frames[:, joint + 1] = frames[:, joint] @ turn @ self.fixed_steps[joint]
        return frames

    def find_flange(self, joints_rad: np.ndarray) -> np.ndarray:
        """(4, 4) base_from_flange of (6,) joint angles."""
        return np.asarray(self.find_frames(np.asarray(joints_rad)[None])[0, -1])

    def seconds_between(self, start_rad: np.ndarray, end_rad: np.ndarray) -> np.ndarray:
        """(N,) seconds that the slowest joint takes from (6,) or (N, 6) angles to (N, 6) ones at full speed."""
        return np.asarray((np.abs(end_rad - start_rad) / self.speed_rad_s).max(-1))


def find_jacobians(frames: np.ndarray) -> np.ndarray:
    """(N, 6, 6) of the flange, for `find_frames`' (N, 7, 4, 4): how it moves (rows 0-2, m) and turns (3-5, rad) a radian of each joint."""
    axes, places = frames[:, :-1, :3, 2], frames[:, :-1, :3, 3]
    moves = np.cross(axes, frames[:, -1:, :3, 3] - places)
    return np.concatenate([moves, axes], 2).transpose(0, 2, 1)


_UPRIGHT_RAD = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
_FULL_TURN, _HALF_TURN = 2 * np.pi, np.pi
_LIMITS_RAD = (_FULL_TURN, _FULL_TURN, _HALF_TURN, _FULL_TURN, _FULL_TURN, _FULL_TURN)  # the elbow cannot turn farther
_HOME_RAD = (0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0)  # the hand points down, before the base

# Universal Robots, "DH Parameters for calculations of kinematics and dynamics" (support article), and the data sheets for limits and
# speeds. Sideways shifts of the tubes are those of Universal Robots' URDF; radii are of its meshes, rounded up.
ARMS = {
    "ur5e": Arm(
        "ur5e", (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0), (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996), _UPRIGHT_RAD,
        tuple(-limit for limit in _LIMITS_RAD), _LIMITS_RAD, (np.pi,) * 6, (0.075, 0.06, 0.055, 0.045, 0.045, 0.04),
        (0.0, 0.138, 0.007, 0.0, 0.0, 0.0), _HOME_RAD,
    ),
    "ur10e": Arm(
        "ur10e", (0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0), (0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655), _UPRIGHT_RAD,
        tuple(-limit for limit in _LIMITS_RAD), _LIMITS_RAD, (2 * np.pi / 3,) * 2 + (np.pi,) * 4, (0.09, 0.08, 0.065, 0.055, 0.05, 0.045),
        (0.0, 0.176, 0.039, 0.0, 0.0, 0.0), _HOME_RAD,
    ),
}  # fmt: skip
"""The arms that options name."""


def find_arm(name: str) -> Arm:
    """The arm of this name. Raises StepError, which lists those that there are."""
    if name not in ARMS:
        raise StepError(f"there is no arm {name}; those that there are: {', '.join(ARMS)}")
    return ARMS[name]
