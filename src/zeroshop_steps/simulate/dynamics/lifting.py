"""One attempt in MuJoCo: approach, close, lift, hold, shake; and the first of these that failed."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.grasp.gripper import Gripper
from zeroshop_steps.simulate.dynamics.mujoco_world import World
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody
from zeroshop_steps.simulate.dynamics.physics import Physics

STAGES = ("approach", "close", "lift", "hold", "shake")
SUCCESS = "success"
BLOCKED_M = 0.01  # the hand is off its place by more at the end of the approach: something is in its way
LIFTED_SHARE = 0.75  # of the way that the hand rises; an object that rises less was not lifted
REST_M_S, MOST_REST_S, REST_STEP_S = 0.003, 3.0, 0.1  # an object slower than this is at rest; it is waited for as long


@dataclass(frozen=True)
class Snapshot:
    """The world at one moment, for pictures; transforms are (4, 4) in metres.

    Attributes:
        stage: that has just ended.
        world_from_object, world_from_gripper: of the true object and the gripper.
        opening_m: between the pads.
    """

    stage: str
    world_from_object: np.ndarray
    world_from_gripper: np.ndarray
    opening_m: float


@dataclass(frozen=True)
class Lift:
    """How an attempt to lift ended.

    Attributes:
        result: `success`, or the first of `STAGES` that failed.
        snapshots: at the end of every stage that was begun.
        slip_mm: how far the object's centre moved in the gripper between closing and the end, of a success.
        world_from_object: where the object lies in the end, put back on the table or fallen.
    """

    result: str
    snapshots: tuple[Snapshot, ...]
    slip_mm: float
    world_from_object: np.ndarray


def settle(body: PhysicalBody, world_from_object: np.ndarray, gripper: Gripper, physics: Physics) -> np.ndarray:
    """world_from_object of the object at rest, (4, 4) in metres, after it was let go at `world_from_object`; no gripper is near."""
    far = make_transform(np.eye(3), [0.0, 0.0, 2.0])
    return _wait_for_rest(World(body, world_from_object, gripper, far, physics))


def lift(
    body: PhysicalBody, world_from_object: np.ndarray, gripper: Gripper, world_from_grasp: np.ndarray, opening_m: float, physics: Physics
) -> Lift:
    """Grasp and lift.

    Args:
        body: the true object.
        world_from_object: (4, 4) m, where it truly lies.
        gripper: the hand.
        world_from_grasp: (4, 4) m, where the robot wants the gripper when it closes.
        opening_m: between the pads on the approach.
        physics: the world's numbers.
    """
    start = world_from_grasp.copy()
    start[:3, 3] -= physics.standoff_m * world_from_grasp[:3, 2]
    world = World(body, world_from_object, gripper, start, physics)
    world.set_opening(opening_m)
    snapshots: list[Snapshot] = []
    held_at = world_from_object
    result = SUCCESS
    for stage in STAGES:
        good = _do(stage, world, world_from_grasp, physics)
        snapshots.append(Snapshot(stage, world.object_pose(), world.gripper_pose(), world.opening_m()))
        if stage == "close":
            held_at = _in_gripper(snapshots[-1])
        if not good:
            result = stage
            break
    moved = _in_gripper(snapshots[-1]) @ np.append(body.centre_m, 1.0) - held_at @ np.append(body.centre_m, 1.0)
    slip_mm = 1000.0 * float(np.linalg.norm(moved[:3])) if result == SUCCESS else float("nan")
    return Lift(result, tuple(snapshots), slip_mm, _let_go(world, gripper))


def _do(stage: str, world: World, world_from_grasp: np.ndarray, physics: Physics) -> bool:
    """Do one stage; whether it went well."""
    if stage == "approach":
        return world.move_hand(world_from_grasp[:3, 3], physics.approach_m_s) < BLOCKED_M
    if stage == "close":
        world.close_fingers()
        return world.both_pads_touch()
    if stage == "lift":
        before = world.object_pose()[2, 3]
        world.move_hand(world.hand_target_m() + [0.0, 0.0, physics.lift_m], physics.lift_m_s)
        return bool(world.object_pose()[2, 3] - before > LIFTED_SHARE * physics.lift_m) and world.both_pads_touch()
    before = world.object_pose()[2, 3]
    if stage == "hold":
        world.run(physics.hold_s)
    else:
        _shake(world, physics)
    return bool(world.object_pose()[2, 3] - before > -(1 - LIFTED_SHARE) * physics.lift_m) and world.both_pads_touch()


def _shake(world: World, physics: Physics) -> None:
    """Swing the hand along x, y and z, one after the other, in whole periods."""
    middle = world.hand_target_m()
    times = np.arange(0.0, physics.hold_s, physics.step_s)
    for axis in np.eye(3):
        for time, following in pairwise(times):
            world.set_hand_target(middle + physics.shake_m * np.sin(2 * np.pi * physics.shake_hz * time) * axis)
            world.run(following - time)
    world.set_hand_target(middle)
    world.run(0.2)


def _let_go(world: World, gripper: Gripper) -> np.ndarray:
    """Lower what is held, open, retreat, and wait until the object is at rest; its pose then."""
    lowest = world.hand_target_m()
    rise = max(0.0, world.object_pose()[2, 3] - world.model.body("object").pos[2])
    if rise > 0.0 and world.both_pads_touch():
        world.move_hand(lowest - [0.0, 0.0, rise], world.physics.lift_m_s)
    for name in ("left", "right"):
        world.data.actuator(name).ctrl[0] = gripper.max_opening_m / 2
    world.run(1.0)
    # Straight up, after the fingers have opened.
    world.move_hand(world.hand_target_m() + [0.0, 0.0, 0.25], world.physics.lift_m_s)
    return _wait_for_rest(world)


def _wait_for_rest(world: World) -> np.ndarray:
    for _ in range(round(MOST_REST_S / REST_STEP_S)):
        world.run(REST_STEP_S)
        if world.object_speed() < REST_M_S:
            break
    return world.object_pose()


def _in_gripper(snapshot: Snapshot) -> np.ndarray:
    """(4, 4) gripper_from_object."""
    return np.linalg.inv(snapshot.world_from_gripper) @ snapshot.world_from_object
