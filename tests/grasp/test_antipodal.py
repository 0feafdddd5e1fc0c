"""Grasps of bodies whose good grasps are known."""

import numpy as np
import pytest
import trimesh

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.metric_mesh import MetricMesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.grasp.antipodal import GraspOptions, find_grasps
from zeroshop_steps.grasp.grasps import read_grasp_array, read_grasps
from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

HSR = GRIPPERS["hsr"]
HSR_FROM_TCP = make_transform(np.eye(3), np.array([0, 0, HSR.tcp_m]))
FEW = GraspOptions(count=40, samples=120)


def metric(shape: trimesh.Trimesh, quality: np.ndarray | None = None) -> MetricMesh:
    mesh = Mesh(np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int64), quality=quality)
    return MetricMesh(mesh, "known", "known_height", 0.003)


@pytest.fixture(scope="module")
def bar() -> trimesh.Trimesh:
    """20 cm long and 5 x 4 cm thick: too long to be closed about."""
    return trimesh.creation.box((0.05, 0.04, 0.20)).subdivide()


def test_a_bar_is_taken_across_and_nothing_touches_the_open_gripper(bar):
    found = find_grasps(metric(bar), HSR, FEW, "bar")
    grasps, placements = found.grasps, found.placements
    assert len(grasps) == 40 and len(placements) == 6
    inside = trimesh.sample.sample_surface(bar, 20000, seed=1)[0]
    for grasp in grasps:
        pose = grasp.object_from_gripper
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9) and np.linalg.det(pose[:3, :3]) > 0
        assert abs(pose[2, 1]) < 0.5, "not along it"
        # Across the bar, at an angle within the friction cone: 26.6 degrees make 50 mm 56 mm.
        assert 0.039 < grasp.width_m < 0.057
        placed = transform_points(inside, np.linalg.inv(pose))
        for low, high in HSR.boxes(np.array([grasp.width_m + 0.03]))[0]:
            assert not ((placed > low + 1e-4) & (placed < high - 1e-4)).all(1).any()
        tcp = (grasp.object_from_gripper @ HSR_FROM_TCP)[:3, 3]
        assert (np.abs(tcp) < (0.025, 0.02, 0.1)).all(), "the tool centre point is inside"
    best = grasps[0]
    assert abs((best.object_from_gripper @ HSR_FROM_TCP)[2, 3]) < 0.03 and max(abs(best.object_from_gripper[:2, 1])) > 0.97


def test_the_table_is_kept_clear_of_in_the_placements_that_a_grasp_names(bar):
    found = find_grasps(metric(bar), HSR, FEW, "bar")
    grasps, placements = found.grasps, found.placements
    corners = np.array([[x, y, z] for box in HSR.boxes(np.array([0.08]))[0] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    for grasp in grasps:
        for number, placement in enumerate(placements):
            heights = transform_points(transform_points(corners, grasp.object_from_gripper), placement.plane_from_object)[:, 2]
            if number in grasp.placements:
                assert heights.min() > -0.012, "opened a little less than here"
    standing = next(number for number, placement in enumerate(placements) if placement.kind == "upright")
    assert any(standing in grasp.placements for grasp in grasps)
    assert not any(grasp.approach[2] > 0.5 for grasp in grasps if standing in grasp.placements), "from below is the table"


def test_what_was_not_measured_is_not_grasped(bar):
    quality = (np.asarray(bar.vertices)[:, 2] > -1e-9).astype(float)
    grasps = find_grasps(metric(bar, quality), HSR, FEW, "bar").grasps
    assert min((grasp.object_from_gripper @ HSR_FROM_TCP)[2, 3] for grasp in grasps) > -0.01


def bowl_with_a_lid() -> trimesh.Trimesh:
    """140 mm high and 200 mm across, as photos see a plain one: its lid, level with the rim, is the only surface that nothing measured."""
    profile = np.array([[0, 0], [75, 0], [100, 140], [95, 140], [50, 140], [0, 140]]) / 1000
    return trimesh.creation.revolve(profile, sections=96).subdivide().subdivide()


def test_a_wide_thing_with_a_lid_is_taken_at_its_rim_as_if_it_were_hollow():
    bowl = bowl_with_a_lid()
    height, across = np.asarray(bowl.vertices)[:, 2], np.linalg.norm(np.asarray(bowl.vertices)[:, :2], axis=1)
    quality = np.where((np.abs(height - 0.14) < 1e-6) & (across < 0.0945), 0.5, 1.0)
    found = find_grasps(metric(bowl, quality), HSR, FEW, "bowl")
    assert found.hollow and len(found.grasps) > 5
    lid = (np.abs(found.points[:, 2] - 0.14) < 1e-4) & (np.linalg.norm(found.points[:, :2], axis=1) < 0.08)
    assert not lid.any(), "the lid is nothing to keep clear of"
    upright = [grasp for grasp in found.grasps if any(found.placements[number].kind == "upright" for number in grasp.placements)]
    assert upright
    for grasp in upright:
        taken = transform_points(np.array([[0.0, 0.0, grasp.contact_m]]), grasp.object_from_gripper)[0]
        assert taken[2] > 0.12 and np.linalg.norm(taken[:2]) > 0.08, "at the wall, near the rim"


def test_a_wide_thing_without_a_lid_is_not_taken_for_hollow():
    with pytest.raises(StepError, match="no grasp"):
        find_grasps(metric(bowl_with_a_lid()), HSR, FEW, "bowl")


def test_what_is_too_wide_is_refused():
    with pytest.raises(StepError, match="crate has no grasp for hsr.*opens wider"):
        find_grasps(metric(trimesh.creation.box((0.3, 0.3, 0.3))), HSR, FEW, "crate")


def test_the_same_seed_gives_the_same_bytes_and_files_are_read_back(tmp_path, bar):
    mesh = Mesh(np.asarray(bar.vertices) * 1000, np.asarray(bar.faces))
    write_ply(tmp_path / "2dgs.ply", mesh)
    write_json(tmp_path / "2dgs.json", {"scale": "known", "scale_source": "known_height", "height_m": 0.2, "height_deviation_m": 0.001})
    for name in ("one", "two"):
        words = ["--method", "antipodal", "--mesh", str(tmp_path / "2dgs.ply"), "--count", "30", "--samples", "120"]
        assert stage_main("zeroshop_steps.grasp", [*words, "--out", str(tmp_path / f"{name}.json")]) == 0
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert (tmp_path / "one.npy").read_bytes() == (tmp_path / "two.npy").read_bytes()
    grasps, array = read_grasps(tmp_path / "one.json"), read_grasp_array(tmp_path / "one.npy")
    assert np.load(tmp_path / "one.npy").shape == (30, 1, 16)
    assert np.allclose([grasp.object_from_gripper for grasp in grasps], array, atol=1e-6)
    assert all(first.score >= second.score for first, second in zip(grasps, grasps[1:], strict=False))
    np.save(tmp_path / "bad.npy", np.ones((3, 1, 16)))
    with pytest.raises(StepError, match="no rigid transforms in metres"):
        read_grasp_array(tmp_path / "bad.npy")
