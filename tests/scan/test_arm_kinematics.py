"""Arms: forward and inverse kinematics agree, limits are obeyed, Jacobians are the derivatives, bodies keep clear."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.arm.arm_reach import ArmReach, CameraHand, ClearanceCheck
from zeroshop_steps.scan.arm.inverse_kinematics import nearest_turns, solve_poses
from zeroshop_steps.scan.arm.kinematics import ARMS, JOINTS, Capsule, find_arm, find_jacobians
from zeroshop_steps.scan.workspace import Box

UR10E = ARMS["ur10e"]
HOME = np.array(UR10E.home_rad)
BOX = Box.around(np.array([0.6, 0.0, 0.1]), np.array([0.14, 0.12, 0.2]))
HAND = CameraHand(np.eye(4), (Capsule(JOINTS, (0.0, 0.0, 0.0), (0.0, 0.0, 0.1), 0.04),))


def view_of_box(azimuth_deg: float, elevation_deg: float, distance_m: float = 0.35) -> np.ndarray:
    direction = direction_at(np.radians(azimuth_deg), np.radians(elevation_deg))
    return np.linalg.inv(look_at(BOX.centre_m + distance_m * direction, BOX.centre_m))


@pytest.mark.parametrize("name", ARMS)
def test_the_flange_is_where_the_data_sheet_draws_it(name: str) -> None:
    # Stretched out along -x, the flange's axis along -y: sums of the data sheet's lengths.
    arm = ARMS[name]
    flange = arm.find_flange(np.zeros(JOINTS))
    d, a = arm.d_m, arm.a_m
    np.testing.assert_allclose(flange[:3, 3], [a[1] + a[2], -(d[3] + d[5]), d[0] - d[4]], atol=1e-12)
    np.testing.assert_allclose(flange[:3, 2], [0.0, -1.0, 0.0], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_postures_that_are_found_reach_the_pose_within_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = ARMS["ur5e"]
    pose = arm.find_frames(rng.uniform(-np.pi, np.pi, (1, JOINTS)))[:, -1]
    (postures,) = solve_poses(arm, pose, 12, rng)
    reached = arm.find_frames(postures)[:, -1]
    np.testing.assert_allclose(reached, np.broadcast_to(pose, reached.shape), atol=2e-4)
    assert arm.within_limits(postures).all()
    assert all(np.abs(np.sin((one - other) / 2)).max() > 0.02 for i, one in enumerate(postures) for other in postures[:i])


def test_nearly_every_pose_that_can_be_reached_is() -> None:
    joints = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, JOINTS))
    found = solve_poses(UR10E, UR10E.find_frames(joints)[:, -1], 12, np.random.default_rng(1))
    assert sum(len(postures) > 0 for postures in found) >= 95


def test_a_pose_out_of_reach_has_no_posture() -> None:
    far = np.eye(4)
    far[0, 3] = 1.6
    assert len(solve_poses(UR10E, far[None], 12, np.random.default_rng(0))[0]) == 0


def test_narrow_limits_are_obeyed() -> None:
    from dataclasses import replace

    narrow = replace(UR10E, low_rad=(-1.0,) * 6, high_rad=(1.0,) * 6)
    joints = np.random.default_rng(2).uniform(-np.pi, np.pi, (60, JOINTS))
    found = solve_poses(narrow, UR10E.find_frames(joints)[:, -1], 12, np.random.default_rng(3))
    assert all(narrow.within_limits(postures).all() for postures in found)


def test_jacobians_are_derivatives() -> None:
    joints = np.random.default_rng(4).uniform(-2, 2, (1, JOINTS))
    jacobian = find_jacobians(UR10E.find_frames(joints))[0]
    for joint in range(JOINTS):
        step = np.zeros((1, JOINTS))
        step[0, joint] = 1e-6
        before, after = (UR10E.find_frames(joints + sign * step)[0, -1] for sign in (-1, 1))
        np.testing.assert_allclose((after - before)[:3, 3] / 2e-6, jacobian[:3, joint], atol=1e-6)
        turn = (after[:3, :3] @ before[:3, :3].T - np.eye(3)) / 2e-6
        np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], jacobian[3:, joint], atol=1e-5)


def test_whole_turns_bring_a_posture_nearer_within_limits() -> None:
    current = np.array([6.0, 0.0, 3.0, -6.0, 0.0, 0.0])
    (nearer,) = nearest_turns(UR10E, np.array([[0.0, 0.1, -3.0, 0.3, 0.0, 0.0]]), current)
    np.testing.assert_allclose(nearer, [2 * np.pi, 0.1, -3.0, 0.3 - 2 * np.pi, 0.0, 0.0], atol=1e-9)
    assert UR10E.within_limits(nearer[None])[0]


def test_an_unknown_arm_is_named() -> None:
    with pytest.raises(StepError, match="no arm ur3; those that there are: ur5e, ur10e"):
        find_arm("ur3")


def test_bodies_keep_clear_of_the_table_the_box_and_themselves() -> None:
    check = ClearanceCheck(UR10E, HAND.body, 0.0, BOX)
    low, folded = HOME.copy(), HOME.copy()
    low[1] = 0.3  # the upper arm goes through the table
    folded[1:3] = -np.pi / 2, 3.05  # the forearm lies in the upper arm
    assert check.is_clear(np.array([HOME, low, folded])).tolist() == [True, False, False]
    (through,) = solve_poses(
        UR10E, np.linalg.inv(look_at(BOX.centre_m + [0, 0.01, 0.15], BOX.centre_m))[None], 12, np.random.default_rng(0)
    )
    assert len(through) and not check.is_clear(through).any()


def test_views_from_nearly_all_sides_are_reached_on_clear_ways() -> None:
    reach = ArmReach(UR10E, HAND, np.eye(4), 0.0, BOX, HOME)
    views = np.array([view_of_box(azimuth, elevation) for elevation in (20, 45, 70) for azimuth in range(0, 360, 45)])
    moves = reach.plan(views)
    assert sum(move is not None for move in moves) >= 20
    for view, move in zip(views, moves, strict=True):
        if move is None:
            continue
        np.testing.assert_allclose(move.world_from_camera[:3, [2, 3]], view[:3, [2, 3]], atol=1e-3)  # but for the roll
        np.testing.assert_allclose(reach.find_camera(move.waypoints_rad[-1]), move.world_from_camera, atol=1e-9)
        assert UR10E.within_limits(np.array(move.waypoints_rad)).all()
        postures = [HOME, *move.waypoints_rad]
        assert all(reach.check.is_path_clear(start, end) for start, end in zip(postures, postures[1:], strict=False))


def test_a_view_from_below_the_table_is_not_reached() -> None:
    reach = ArmReach(UR10E, HAND, np.eye(4), 0.0, BOX, HOME)
    assert reach.plan(view_of_box(180, -40)[None]) == [None]


def test_a_base_that_is_turned_and_raised_sees_the_same_world() -> None:
    world_from_base = np.array([[0.0, -1, 0, 0.6], [1, 0, 0, -0.6], [0, 0, 1, 0.1], [0, 0, 0, 1]])
    reach = ArmReach(UR10E, HAND, world_from_base, 0.0, BOX, HOME)
    (move,) = reach.plan(view_of_box(-90, 45)[None])
    assert move is not None
    np.testing.assert_allclose(move.world_from_camera[:3, 3], view_of_box(-90, 45)[:3, 3], atol=1e-3)
    assert reach.check.table_m == pytest.approx(-0.1)
