"""A whole attempt: a carton is photographed, detected, located, grasped and lifted; and one that fails leaves its row and its picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.bop.export_models import write_model
from zeroshop_steps.bop.formats.bop_scenes import read_scene, write_scene
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.detect.templates import render_templates
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.grasp.antipodal import GraspOptions
from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.simulate.attempts import Trial, grasps_of_model
from zeroshop_steps.simulate.camera import in_memory
from zeroshop_steps.simulate.dynamics.lifting import settle
from zeroshop_steps.simulate.dynamics.physical_body import write_body
from zeroshop_steps.simulate.dynamics.physics import USUAL
from zeroshop_steps.simulate.perception import Perception
from zeroshop_steps.simulate.physical_model import find_mass_kg, make_body
from zeroshop_steps.simulate.protocol import choose_poses
from zeroshop_steps.simulate.protocol_images import FirstLook, photograph_rest
from zeroshop_steps.simulate.robot import Robot
from zeroshop_steps.simulate.true_object import TrueObject, read_true_object
from zeroshop_steps.synthetic.demo_objects import write_demo_object

pytest.importorskip("mujoco", reason="needs zeroshop[robot]")
pytest.importorskip("coacd", reason="needs zeroshop[robot]")
pytestmark = pytest.mark.slow
HSR = GRIPPERS["hsr"]


@pytest.fixture(scope="module")
def carton(tmp_path_factory: pytest.TempPathFactory) -> tuple[TrueObject, FirstLook, Robot]:
    """The gelatin carton, upright, seen for the first time, and a robot that knows its true mesh."""
    folder = tmp_path_factory.mktemp("carton")
    write_demo_object("gelatin_carton", folder / "model")
    mesh = read_ply(folder / "model/model.ply")
    write_body(folder / "body.npz", make_body(mesh, find_mass_kg("demo/gelatin_carton"), "model.ply"))
    true = read_true_object(folder / "model", folder / "body.npz", None)
    info = read_json(folder / "model/model_info.json")
    write_json(folder / "models/models_info.json", {str(true.object_id): write_model(folder / "models", mesh, info)})
    pose = choose_poses(true.body, "carton")[0]
    pose = replace(pose, world_from_object=settle(true.body, pose.world_from_object, HSR, USUAL))
    scene = folder / "000001"
    write_scene(scene, [photograph_rest(scene, true, pose.world_from_object, [0], 1)])
    frame = read_scene(scene)[1]
    known = grasps_of_model(folder / "models", true.object_id, HSR, GraspOptions(count=40, samples=300))
    perception = make_perception(folder / "models", folder / "views")
    return true, FirstLook(pose, in_memory(frame), frame.mask(0)), Robot(perception, true.object_id, known, HSR)


def make_perception(models: Path, views: Path) -> Perception:
    views.mkdir()
    for model in read_models(models, list_objects(models)).values():
        np.savez(views / f"obj_{model.object_id:06d}.npz", **vars(render_templates(model, 42, 224)))
    return Perception(models, views)


def test_a_carton_is_found_and_lifted(carton, tmp_path: Path) -> None:
    true, look, robot = carton
    assert look.frame.photo.shape == (480, 640, 3)
    (row,) = Trial(true, robot, 0, tmp_path / "failures").try_pose(look, [USUAL.friction])
    assert (row["result"], row["segmented"], row["attempt"]) == ("success", 1, 1)
    assert row["pose_error_diameters"] < 0.05
    assert row["slip_mm"] < 2.0
    assert not (tmp_path / "failures").exists()


def test_a_failure_is_tried_again_and_pictured(carton, tmp_path: Path) -> None:
    true, look, robot = carton
    beside = [replace(grasp, object_from_gripper=shifted(grasp.object_from_gripper)) for grasp in robot.known.grasps]
    rows = Trial(true, replace(robot, known=replace(robot.known, grasps=beside)), 0, tmp_path / "failures").try_pose(look, [USUAL.friction])
    assert [row["result"] for row in rows] == ["close", "close"]
    pictures = sorted((tmp_path / "failures").iterdir())
    assert [path.stem.split("_attempt_")[1] for path in pictures] == ["1_close", "2_close"]
    assert read_image(pictures[0]).shape == (320, 960, 3)


def shifted(object_from_gripper: np.ndarray) -> np.ndarray:
    """15 cm back: the fingers close before the object."""
    pose = object_from_gripper.copy()
    pose[:3, 3] -= 0.15 * pose[:3, 2]
    return pose
