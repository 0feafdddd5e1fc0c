"""A rendered capture in the layout of a BOP training set."""

import json

import numpy as np
import pytest

from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.geometry.imaging.images import read_image, read_mask, write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.synthetic.raycast import capture
from zeroshop_steps.synthetic.scenes.distractors import make_distractor


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """A model folder, and its capture below."""
    folder, mesh = tmp_path_factory.mktemp("model"), make_distractor(np.random.default_rng(3))
    write_image(folder / "model.png", mesh.texture)
    write_ply(folder / "model.ply", mesh, "model.png")
    write_json(folder / "model_info.json", {"name": "thing", "obj_id": 7})
    capture(folder / "model.ply", "se", 96, 72, 0, folder / "capture")
    return folder, mesh


def make(out, captures, models) -> int:
    words = [
        "--method",
        "make_train_scenes",
        "--captures",
        *captures,
        "--models",
        *models,
        "--camera",
        out / "camera.json",
        "--out",
        out / "train",
    ]
    return stage_main("zeroshop_steps.synthetic", ["--method", "make_train_scenes", *map(str, words)])


def test_the_layout_is_bops_and_the_poses_put_the_model_where_it_is(captured, tmp_path):
    folder, mesh = captured
    assert make(tmp_path, [folder / "capture"], [folder]) == 0
    scene = tmp_path / "train/000007"
    assert sorted(path.name for path in scene.iterdir()) == [
        "depth", "mask", "mask_visib", "rgb", "scene_camera.json", "scene_gt.json", "scene_gt_info.json",
    ]  # fmt: skip
    frames = read_scene(scene)
    assert sorted(frames) == list(range(30)) and json.loads((tmp_path / "camera.json").read_text())["width"] == 96
    renderer = DepthRenderer(mesh)
    for number in (0, 13, 27):
        frame = frames[number]
        [instance] = frame.instances
        assert instance.object_id == 7 and instance.visible_share == 1.0
        shown = renderer.render(instance.camera_from_model, frame.intrinsics, 96, 72).image(96, 72)
        mask, depth = frame.mask(0), frame.depth_mm()
        assert (mask == (shown > 0)).all()
        assert np.abs(depth - shown)[mask & (depth > 0)].max() < 10 and np.median(np.abs(depth - shown)[mask]) < 0.1
        seen = read_mask(folder / "capture/masks" / f"{number:06d}.png")
        assert (mask & seen).sum() > 0.9 * (mask | seen).sum()
        assert (read_image(frame.image_path("rgb")) == read_image(folder / "capture/images" / f"{number:06d}.png")).all()


def test_captures_that_do_not_fit_are_named(captured, tmp_path, capsys):
    folder, _ = captured
    assert make(tmp_path, [folder / "capture"] * 2, [folder] * 2) == 1
    assert "same object, 7" in capsys.readouterr().err
    assert make(tmp_path, [folder / "capture"], [folder] * 2) == 1
    assert "give each capture its model" in capsys.readouterr().err
    assert make(tmp_path, [folder], [folder]) == 1
    assert "has no truth/" in capsys.readouterr().err and not (tmp_path / "train").exists()
