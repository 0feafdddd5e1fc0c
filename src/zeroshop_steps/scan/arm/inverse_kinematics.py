"""Joint angles for a pose of the flange: damped least squares (Wampler 1986; Nakamura and Hanafusa 1986) from many starts at once.

It needs no closed form, so it takes any arm of six joints. It finds most, not all, of the up to sixteen postures that reach a pose.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.scan.arm.kinematics import JOINTS, Arm, find_jacobians

LEVER_M = 0.3  # a turn of a radian counts as much as a shift by this: about an arm's wrist and hand
DAMPING = 0.02  # of the steps: near a singular posture they stay short
MOST_STEP_RAD = 0.6  # of a joint at once: beyond, the linear model says nothing
ROUNDS = 60
REACHED_M, REACHED_RAD = 1e-5, 1e-4  # the pose counts as reached: a hundredth of what such arms repeat
SAME_RAD = 0.05  # postures nearer than this in all joints are one


def solve_poses(arm: Arm, base_from_flange: np.ndarray, starts: int, rng: np.random.Generator) -> list[np.ndarray]:
    """For each pose, the postures that reach it.

    Args:
        arm: whose limits they obey.
        base_from_flange: (N, 4, 4) in metres.
        starts: postures that the search begins at, for each pose.
        rng: draws them.

    Returns:
        N arrays (S, 6) of joint angles in radians; S is 0 where none was found.
    """
    count = len(base_from_flange)
    low, high = np.maximum(arm.low_rad, -np.pi), np.minimum(arm.high_rad, np.pi)
    joints = rng.uniform(low, high, (count, starts, JOINTS)).reshape(-1, JOINTS)
    # The first axis points the arm at the place, or away from it, in most postures.
    azimuths = np.arctan2(base_from_flange[:, 1, 3], base_from_flange[:, 0, 3])
    joints[:, 0] = np.repeat(azimuths, starts) + rng.choice([0.0, np.pi], len(joints)) + rng.normal(0.0, 0.3, len(joints))
    targets = np.repeat(base_from_flange, starts, 0)
    reached = _descend(arm, joints, targets).reshape(count, starts)
    joints = _wrap(joints)
    reached &= arm.within_limits(joints).reshape(count, starts)
    found = joints.reshape(count, starts, JOINTS)
    return [_take_different(found[index][reached[index]]) for index in range(count)]


def nearest_turns(arm: Arm, joints_rad: np.ndarray, current_rad: np.ndarray) -> np.ndarray:
    """(N, 6) the same postures with each joint turned by whole turns, within its limits, as near the (6,) current angles as can be."""
    turns = np.round((current_rad - joints_rad) / (2 * np.pi))
    turns = np.clip(turns, np.ceil((arm.low_rad - joints_rad) / (2 * np.pi)), np.floor((arm.high_rad - joints_rad) / (2 * np.pi)))
    return np.asarray(joints_rad + 2 * np.pi * turns)


def _descend(arm: Arm, joints: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Move (N, 6) joint angles, in place, towards (N, 4, 4) poses; (N,) bool, those that reach them."""
    scale = np.array([1.0] * 3 + [LEVER_M] * 3)
    reached, active = np.zeros(len(joints), bool), np.arange(len(joints))
    for _ in range(ROUNDS):
        frames = arm.find_frames(joints[active])
        error = _difference(frames[:, -1], targets[active])
        done = (np.linalg.norm(error[:, :3], axis=1) < REACHED_M) & (np.linalg.norm(error[:, 3:], axis=1) < REACHED_RAD)
        reached[active[done]] = True
        active, frames, error = active[~done], frames[~done], error[~done]
        if not len(active):
            break
        jacobian = find_jacobians(frames) * scale[:, None]
        square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING**2 * np.eye(6)
        step = np.einsum("nji,nj->ni", jacobian, np.linalg.solve(square, (error * scale)[..., None])[..., 0])
        step *= np.minimum(1.0, MOST_STEP_RAD / np.maximum(np.abs(step).max(1), 1e-12))[:, None]
        joints[active] += step
    return reached


def _difference(now: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N, 6) shift in metres and turn in radians, along the base's axes, that take (N, 4, 4) poses to others."""
    turns = Rotation.from_matrix(wanted[:, :3, :3] @ now[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
    return np.concatenate([wanted[:, :3, 3] - now[:, :3, 3], turns], 1)


def _wrap(joints: np.ndarray) -> np.ndarray:
    return np.asarray((joints + np.pi) % (2 * np.pi) - np.pi)


def _take_different(joints: np.ndarray) -> np.ndarray:
    """(S, 6) without postures that are the same up to whole turns."""
    kept: list[np.ndarray] = []
    for one in _wrap(joints):
        if all(np.abs(_wrap(one - other)).max() > SAME_RAD for other in kept):
            kept.append(one)
    return np.array(kept).reshape(-1, JOINTS)
