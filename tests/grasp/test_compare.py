"""Given grasps are judged by the checks that ours pass."""

import numpy as np
import pytest
import trimesh

from helpers.faults import step
from helpers.small_bodies import write_product
from zeroshop_steps.grasp.compare import find_nearest, judge
from zeroshop_steps.grasp.grasps import Grasp, write_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.grasp.surface import make_grasp_surface
from zeroshop_steps.runtime.tables import read_table

HSR = GRIPPERS["hsr"]
FROM_ABOVE = np.diag([1.0, -1.0, -1.0, 1.0])
"""Approach along -z, closing along y."""


def above(height_m: float, shift_m: float = 0.0, tilt_deg: float = 0.0) -> np.ndarray:
    """From above, the tool centre point at this height, moved along the closing axis and turned about the approach."""
    pose = FROM_ABOVE.copy()
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    pose[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ pose[:3, :3]
    pose[:3, 3] = (0, shift_m, height_m + HSR.tcp_m)
    return pose


@pytest.fixture(scope="module")
def box():
    """60 x 40 x 100 mm."""
    return trimesh.creation.box((60, 40, 100)).subdivide()


def test_each_reason_is_found(box):
    from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

    surface = make_grasp_surface(Mesh(np.asarray(box.vertices) / 1000, np.asarray(box.faces)), np.random.default_rng(0))
    poses = np.array([above(0.03), above(0.2), above(0.03, tilt_deg=40), above(0.03, shift_m=0.03), above(-0.03)])
    verdicts = judge(surface, poses, HSR, 0.5)
    assert verdicts.reasons.tolist() == ["accepted", "misses", "slips", "collides", "collides"]
    assert np.isclose(verdicts.widths_m[0], 0.04, atol=1e-4) and np.isnan(verdicts.widths_m[1])
    assert verdicts.slip_deg[0] < 2 and verdicts.slip_deg[2] > 30


def test_the_nearest_is_the_same_where_the_gripper_is_turned_by_half():
    turned = above(0.03) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    distance, approach, closing = find_nearest(above(0.03)[None], np.array([above(0.05), turned]), HSR)
    assert np.allclose((distance, approach, closing), 0, atol=1e-6)


def test_a_table_has_a_row_for_each_given_grasp(box, tmp_path):
    mesh = write_product(tmp_path / "2dgs.ply", box)
    write_grasps(tmp_path / "ours.json", [Grasp(above(0.03), 0.04, HSR.tcp_m, 0.9)], {})
    np.save(tmp_path / "given.npy", np.array([above(0.04), above(0.2)]).reshape(-1, 1, 16))
    out = tmp_path / "compare.csv"
    assert step("grasp", "compare", mesh=mesh, grasps=tmp_path / "ours.json", given=tmp_path / "given.npy", out=out) == 0
    table = read_table(out)
    assert table["verdict"].tolist() == ["accepted", "misses"] and table["nearest_mm"].tolist() == ["10.0", "170.0"]
