"""Several things on a table: clear ones stand apart in the image, overlapping ones touch, and a robot's view of them has its rows."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from zeroshop_steps.bop.export_models import write_model
from zeroshop_steps.bop.formats.bop_scenes import HALF_PX, list_scenes, read_scene
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.scoring.depth_render import DepthRenderer
from zeroshop_steps.detect.templates import render_templates
from zeroshop_steps.geometry.imaging.images import read_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.runtime.tables import read_table
from zeroshop_steps.simulate.camera import HEIGHT_PX, WIDTH_PX, hsr_camera
from zeroshop_steps.simulate.scenes import Layout
from zeroshop_steps.synthetic.demo_objects import write_demo_object
from zeroshop_steps.synthetic.scenes.clutter import make_body

NAMES = ("gelatin_carton", "tomato_can")


def layout_of(*sizes_mm: tuple[float, float, float]) -> Layout:
    boxes = [trimesh.creation.box(size) for size in sizes_mm]
    meshes = [Mesh(np.asarray(box.vertices, float), np.asarray(box.faces, np.int64)) for box in boxes]
    return Layout([make_body(mesh.vertices) for mesh in meshes], [DepthRenderer(mesh) for mesh in meshes])


def silhouettes(layout: Layout, poses: list[np.ndarray]) -> list[np.ndarray]:
    camera = hsr_camera()
    patches = [
        renderer.render(camera.camera_from_world @ pose, camera.intrinsics - HALF_PX, WIDTH_PX, HEIGHT_PX)
        for renderer, pose in zip(layout.renderers, poses, strict=True)
    ]
    return [patch.image(WIDTH_PX, HEIGHT_PX) > 0 for patch in patches]


@pytest.mark.parametrize("clear", [True, False])
def test_things_stand_apart_or_touch_in_the_image(clear: bool) -> None:
    layout = layout_of((60, 40, 200), (80, 80, 80), (50, 120, 30))
    seen = silhouettes(layout, layout.draw(np.random.default_rng(3), clear))
    assert all(one.any() and not (one[0].any() or one[-1].any() or one[:, 0].any() or one[:, -1].any()) for one in seen)
    counts = np.sum(seen, 0)
    if clear:
        assert counts.max() == 1
    else:
        grown = [cv2.dilate(one.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0 for one in seen]
        assert all(any((grown[i] & seen[j]).any() for j in range(3) if j != i) for i in range(3))


def test_what_does_not_fit_into_the_image_is_refused() -> None:
    with pytest.raises(StepError, match="no room on the table"):
        layout_of((900, 900, 50)).draw(np.random.default_rng(0), True)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two true models."""
    folder, infos = tmp_path_factory.mktemp("things"), {}
    for name in NAMES:
        write_demo_object(name, folder / name)
        info = read_json(folder / name / "model_info.json")
        infos[str(info["obj_id"])] = write_model(folder / "models", read_ply(folder / name / "model.ply"), info)
    write_json(folder / "models/models_info.json", infos)
    return folder / "models"


@pytest.mark.slow
def test_a_robot_sees_two_things(models: Path, tmp_path: Path) -> None:
    words = ["--models", str(models), "--clear-scenes", "1", "--overlapping-scenes", "1", "--threads", "1"]
    assert stage_main("zeroshop_steps.simulate", ["--method", "scenes", *words, "--out", str(tmp_path / "scenes")]) == 0
    scenes = list_scenes(tmp_path / "scenes")
    (clear,) = read_scene(scenes[1]).values()
    assert [instance.visible_share for instance in clear.instances] == pytest.approx([1.0, 1.0], abs=0.01)
    (tmp_path / "views").mkdir()
    for model in read_models(models, list_objects(models)).values():
        np.savez(tmp_path / f"views/obj_{model.object_id:06d}.npz", **vars(render_templates(model, 42, 224)))
    words = ["--truth", str(models), "--models", str(models), "--templates", str(tmp_path / "views"), "--out", str(tmp_path / "seen")]
    assert stage_main("zeroshop_steps.simulate", ["--method", "sightings", "--scenes", str(tmp_path / "scenes"), *words]) == 0
    table = read_table(tmp_path / "seen/scenes.csv")
    assert list(table.kind) == ["clear", "clear", "overlapping", "overlapping"]
    assert list(table[table.kind == "clear"].segmented) == ["1", "1"]
    assert list(table[table.kind == "clear"].pose_right) == ["1", "1"]
    assert read_image(tmp_path / "seen/000001.png").shape == (HEIGHT_PX, WIDTH_PX, 3)


def test_one_thing_is_not_several(models: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    infos = read_json(models / "models_info.json")
    (first, *_) = infos
    write_json(tmp_path / "one/models_info.json", {first: infos[first]})
    for path in models.glob(f"obj_{int(first):06d}.*"):
        (tmp_path / "one" / path.name).write_bytes(path.read_bytes())
    words = ["--method", "scenes", "--models", str(tmp_path / "one"), "--out", str(tmp_path / "scenes")]
    assert stage_main("zeroshop_steps.simulate", words) == 1
    assert "two or more" in capsys.readouterr().err
    assert not (tmp_path / "scenes").exists()
