"""The eight poses, the choice of a grasp above the table, and masses."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from helpers.solids import as_trimesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.simulate.attempts import close_below
from zeroshop_steps.simulate.dynamics.physical_body import PhysicalBody
from zeroshop_steps.simulate.physical_model import find_mass_kg
from zeroshop_steps.simulate.protocol import choose_poses
from zeroshop_steps.simulate.robot import put_on_table

HSR = GRIPPERS["hsr"]


def body_of(shape: trimesh.Trimesh) -> PhysicalBody:
    return PhysicalBody((np.asarray(shape.vertices),), 1.0, np.asarray(shape.center_mass), np.eye(3))


def test_a_box_is_turned_upright_and_flipped() -> None:
    poses = choose_poses(body_of(trimesh.creation.box((0.05, 0.04, 0.1))), "box")
    assert [(pose.placement, pose.turn_deg) for pose in poses] == [
        (kind, turn) for kind in ("upright", "flipped") for turn in (0.0, 90.0, 180.0, 270.0)
    ]
    assert poses[0].world_from_object[:3, 0] == pytest.approx([-1, 0, 0], abs=1e-6)  # its front faces the robot
    assert poses[1].world_from_object[:3, 0] == pytest.approx([0, -1, 0], abs=1e-6)
    assert poses[4].world_from_object[2, 2] == pytest.approx(-1)


def test_what_cannot_be_flipped_lies() -> None:
    cone = trimesh.creation.cone(0.04, 0.1)
    assert {pose.placement for pose in choose_poses(body_of(cone), "cone")} == {"upright", "lying"}


def test_what_always_stands_up_has_no_second_placement() -> None:
    tumbler = PhysicalBody((np.asarray(trimesh.creation.cone(0.1, 0.02).vertices),), 1.0, np.array([0.0, 0.0, 1e-4]), np.eye(3))
    with pytest.raises(StepError, match="fewer than two ways"):
        choose_poses(tumbler, "tumbler")


def test_what_stands_on_the_table_is_put_there() -> None:
    corners = np.array(list(np.ndindex(2, 2, 2)), float) * 0.1
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("x", 30, degrees=True).as_matrix()
    turned[2, 3] = 0.007
    resting = put_on_table(turned, corners)
    assert (corners @ resting[2, :3] + resting[2, 3]).min() == pytest.approx(0.0)
    assert resting[:2] == pytest.approx(turned[:2])
    turned[2, 3] = 0.1  # on something else, or wrong
    assert put_on_table(turned, corners)[2, 3] == 0.1


def test_an_open_underside_is_closed_and_unseen() -> None:
    shape = trimesh.creation.box((0.05, 0.04, 0.1)).subdivide().subdivide()
    up = np.asarray(shape.face_normals)[:, 2] > -0.9
    closed = close_below(Mesh(np.asarray(shape.vertices), np.asarray(shape.faces)[up]))
    assert as_trimesh(closed).is_watertight
    assert as_trimesh(closed).volume == pytest.approx(0.05 * 0.04 * 0.1, rel=0.02)
    assert 0.8 < closed.face_areas()[~closed.measured_faces()].sum() / (0.05 * 0.04) < 1.05


def test_masses_are_known_or_asked_for() -> None:
    assert find_mass_kg("ycbv/obj_000005") == 0.603
    with pytest.raises(StepError, match="assets: {masses_kg: {mine: {cup: 0.2}}}"):
        find_mass_kg("mine/cup")
