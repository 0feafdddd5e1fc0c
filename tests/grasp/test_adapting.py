"""Grasps adapted to where an object lies: nothing enters the table, and thin things can be taken from it."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.meshes.metric_mesh import MetricMesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.grasp.adapting import best_above_table
from zeroshop_steps.grasp.antipodal import GraspOptions, find_grasps
from zeroshop_steps.grasp.clearance import BEHIND_M, CORNERS
from zeroshop_steps.grasp.grasps import Grasp
from zeroshop_steps.grasp.gripper import GRIPPERS

HSR = GRIPPERS["hsr"]
FRICTION = 0.5
NOTHING = np.full((1, 3), 9.0)  # a surface that is nowhere near


def grasp_along(approach: np.ndarray, score: float, closing: np.ndarray | None = None) -> Grasp:
    """Contacts at the origin, 50 mm apart, in the middle of the pads."""
    across = np.array([1.0, 0.0, 0.0]) if closing is None else closing
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(across, approach), across, approach], 1)
    pose[:3, 3] = -HSR.tcp_m * approach
    return Grasp(pose, 0.05, HSR.tcp_m, score, (), {"friction": 1.0, "robustness": score, "balance": 1.0})


def lowest_m(world_from_gripper: np.ndarray, opening_m: float) -> float:
    """Of the open gripper on its approach."""
    corners = HSR.boxes(np.array([opening_m]), BEHIND_M).reshape(3, 6)[:, CORNERS].reshape(24, 3)
    return float((corners @ world_from_gripper[2, :3] + world_from_gripper[2, 3]).min())


def at_height(height_m: float, turn: Rotation | None = None) -> np.ndarray:
    pose = np.eye(4)
    if turn is not None:
        pose[:3, :3] = turn.as_matrix()
    pose[2, 3] = height_m
    return pose


def test_the_best_grasp_that_keeps_clear_of_the_table_is_taken() -> None:
    grasps = [grasp_along(np.array([0.0, 0.0, 1.0]), 0.9), grasp_along(np.array([0.0, 0.0, -1.0]), 0.8)]
    upright, flipped = at_height(0.05), at_height(0.05, Rotation.from_euler("x", 180, degrees=True))
    for place in (upright, flipped):
        chosen = best_above_table(grasps, NOTHING, place, HSR, FRICTION)
        assert chosen is not None and chosen.world_from_gripper[2, 2] == pytest.approx(-1.0)
        assert chosen.opening_m == pytest.approx(0.08)
    assert best_above_table([], NOTHING, upright, HSR, FRICTION) is None
    assert best_above_table(grasps, NOTHING, at_height(0.004), HSR, FRICTION) is None  # contacts nearer to the table than any finger


def test_a_grasp_stays_back_where_the_fingers_would_reach_the_table() -> None:
    down = [grasp_along(np.array([0.0, 0.0, -1.0]), 0.8)]
    high, low = (best_above_table(down, NOTHING, at_height(height), HSR, FRICTION) for height in (0.05, 0.012))
    assert high is not None and low is not None
    assert high.world_from_gripper[2, 3] - 0.05 == pytest.approx(HSR.tcp_m)
    assert low.world_from_gripper[2, 3] - 0.012 > HSR.tcp_m + 0.003
    assert lowest_m(low.world_from_gripper, low.opening_m) > 0.002


def test_a_tilted_grasp_is_levelled_within_the_friction_cone() -> None:
    def tilted(angle_deg: float) -> list[Grasp]:
        turn = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
        return [grasp_along(turn @ np.array([0.0, 0.0, -1.0]), 0.8, turn @ np.array([1.0, 0.0, 0.0]))]

    chosen = best_above_table(tilted(20), NOTHING, at_height(0.01), HSR, FRICTION)
    assert chosen is not None and chosen.world_from_gripper[2, 1] == pytest.approx(0.0, abs=1e-9)
    assert best_above_table(tilted(30), NOTHING, at_height(0.01), HSR, FRICTION) is None  # atan(0.5) is 27 degrees


def test_the_object_itself_is_kept_clear_of() -> None:
    down = [grasp_along(np.array([0.0, 0.0, -1.0]), 0.8)]
    in_a_finger = np.array([[0.045, 0.0, 0.02]])
    assert best_above_table(down, in_a_finger, at_height(0.05), HSR, FRICTION) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_pen_is_taken_from_the_table_however_it_is_rolled(seed: int) -> None:
    solid = trimesh.creation.cylinder(0.009, 0.12, sections=48).subdivide().subdivide()
    mesh = Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64))
    options = GraspOptions(count=100, samples=800, seed=seed)
    found = find_grasps(MetricMesh(mesh, "known", "test", 0.0), HSR, options, "pen")
    for roll in np.random.default_rng(seed).uniform(0, 360, 6):
        pose = at_height(0.009, Rotation.from_euler("zx", [roll, 90], degrees=True))
        chosen = best_above_table(found.grasps, found.points, pose, HSR, FRICTION)
        assert chosen is not None, roll
        assert lowest_m(chosen.world_from_gripper, chosen.opening_m) > 0.002
