"""Captures by BlenderProc: with a pretended Blender the files, restarts and faults; with the real one, where it is, a tiny scene."""

import filecmp

import numpy as np
import pytest

from helpers.pretend_blender import prepare
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.imaging.images import read_depth_mm, read_image, read_mask, write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic import blenderproc, raycast
from zeroshop_steps.synthetic.blender_environment import SYSTEM_PACKAGES, explain_fault
from zeroshop_steps.synthetic.demo_objects import write_demo_object

WIDTH, HEIGHT = 64, 48


def capture(model, out, environment, scene="se", seed=0, width_px=WIDTH, samples=2):
    blenderproc.capture(model, scene, width_px, HEIGHT * width_px // WIDTH, seed, samples, environment, 2, out)


def frames(out):
    return sorted(path.name for path in blenderproc.frames_folder(out).glob("frame_*"))


def test_the_files_and_cameras_are_those_of_the_ray_caster(box, tmp_path):
    capture(box, tmp_path / "blender", prepare(tmp_path))
    raycast.capture(box, "se", WIDTH, HEIGHT, 0, tmp_path / "ray")
    names = [sorted(str(path.relative_to(folder)) for path in folder.rglob("*")) for folder in (tmp_path / "blender", tmp_path / "ray")]
    assert names[0] == names[1] and len(names[0]) > 90
    for file in ("truth/cameras.bin", "truth/images.bin", "held_out/truth/images.bin"):
        assert filecmp.cmp(tmp_path / "blender" / file, tmp_path / "ray" / file, shallow=False)
    facts, others = (read_json(tmp_path / name / "capture.json") for name in ("blender", "ray"))
    assert facts["renderer"] == "blenderproc" and facts["samples"] == 2 and others["renderer"] == "raycast"
    same = set(others) - {"seconds", "renderer"}
    assert {key: facts[key] for key in same} == {key: others[key] for key in same}
    image, mask = read_image(tmp_path / "blender/images/000003.png"), read_mask(tmp_path / "blender/masks/000003.png")
    assert not image[~mask].any() and 100 < image[mask].mean() < 140
    assert read_depth_mm(tmp_path / "blender/depth/000003.png")[mask].mean() == pytest.approx(300.0)
    assert not blenderproc.frames_folder(tmp_path / "blender").exists()


def test_a_killed_render_is_taken_up_at_the_first_missing_frame(box, tmp_path, capfd):
    out = tmp_path / "capture"
    with pytest.raises(StepError, match="killed.*goes on from there"):
        capture(box, out, prepare(tmp_path, killed_after=3))
    assert not out.exists() and frames(out) == [f"frame_{index:06d}.npz" for index in range(3)]
    damaged = blenderproc.frames_folder(out) / "frame_000001.npz"
    damaged.write_bytes(damaged.read_bytes()[:500])
    capfd.readouterr()
    capture(box, out, prepare(tmp_path))
    progress = capfd.readouterr().err
    assert "(2 of 32 were there): 1/30" in progress and "30/30, 0 s left" in progress
    assert len(list((out / "images").iterdir())) == 30


@pytest.mark.slow
def test_a_test_set_goes_on_after_a_kill(box, tmp_path, capsys):
    """Tables of the box alone: fallen, rendered, and annotated as a BOP dataset."""
    mesh, models = read_ply(box), tmp_path / "models"
    models.mkdir()
    write_image(models / "obj_000001.png", mesh.texture)
    write_ply(models / "obj_000001.ply", mesh, "obj_000001.png")
    write_json(models / "models_info.json", {"1": {"diameter": float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))}})
    words = ["--method", "make_test_scenes", "--models", models, "--scenes", 1, "--images", 3, "--width-px", WIDTH, "--height-px", HEIGHT]
    words += [
        "--renderer",
        "blenderproc",
        "--samples",
        1,
        "--environment",
        tmp_path / "environment.json",
        "--camera",
        tmp_path / "camera.json",
    ]
    words += ["--targets", tmp_path / "targets.json", "--out", tmp_path / "test"]
    prepare(tmp_path, killed_after=2)
    assert stage_main("zeroshop_steps.synthetic", ["--method", "make_test_scenes", *map(str, words)]) == 1
    assert "Blender was killed" in capsys.readouterr().err and not (tmp_path / "test").exists()
    prepare(tmp_path)
    assert stage_main("zeroshop_steps.synthetic", ["--method", "make_test_scenes", *map(str, words)]) == 0
    assert "(2 of 3 were there)" in capsys.readouterr().err
    poses = read_json(tmp_path / "test/000001/scene_gt.json")
    assert len(poses) == 3 and all(pose["obj_id"] == 1 for pose in poses["0"])
    assert len(list((tmp_path / "test/000001/rgb").iterdir())) == len(list((tmp_path / "test/000001/depth").iterdir())) == 3


@pytest.mark.parametrize("change", [{"seed": 1}, {"samples": 3}, {"width_px": 128}])
def test_frames_of_another_scene_are_not_taken(box, tmp_path, capfd, change):
    out = tmp_path / "capture"
    with pytest.raises(StepError):
        capture(box, out, prepare(tmp_path, killed_after=2))
    capfd.readouterr()
    with pytest.raises(StepError):
        capture(box, out, prepare(tmp_path, killed_after=1), **change)
    assert "were there" not in capfd.readouterr().err and len(frames(out)) == 1


def test_faults_of_the_environment_say_what_to_do(box, tmp_path):
    for told, words in (
        ("libXrender.so.1: cannot open shared object file: No such file or directory", "libXrender.so.1.*apt-get install libxrender1"),
        ("libfoo.so.3: cannot open shared object file: No such file or directory", "libfoo.so.3.*apt-file search"),
        ("No module named 'bpy'", "lacks the module bpy.*blenderproc.txt.*raycast"),
        ("bpy has version 5.0.1, expected 4.2.23", "5.0.1, expected 4.2.23.*blenderproc.txt"),
    ):
        with pytest.raises(StepError, match=words):
            capture(box, tmp_path / "out", prepare(tmp_path, fault=told))
    with pytest.raises(StepError, match="(?s)status 3.*no space left"):
        capture(box, tmp_path / "out", prepare(tmp_path, fails="no space left"))
    environment = prepare(tmp_path)
    (tmp_path / "python").unlink()
    with pytest.raises(StepError, match="python of BlenderProc's environment is gone; delete .*environment.json"):
        capture(box, tmp_path / "out", environment)
    with pytest.raises(StepError, match="blender_environment"):
        capture(box, tmp_path / "out", None)
    assert not (tmp_path / "out").exists()
    assert all(package in explain_fault(f"{library}: cannot open shared object file", "it") for library, package in SYSTEM_PACKAGES.items())


def test_bad_models_and_options_are_named(box, tmp_path):
    mesh = read_ply(box)
    write_ply(tmp_path / "metres.ply", Mesh(mesh.vertices / 1000, mesh.faces))
    write_ply(tmp_path / "point.ply", Mesh(mesh.vertices * 0, mesh.faces))
    write_ply(tmp_path / "lost.ply", mesh, "lost.png")
    environment = prepare(tmp_path)
    for name, words in (
        ("metres.ply", "millimetres"),
        ("point.ply", "no size"),
        ("lost.ply", "lost.png"),
    ):
        with pytest.raises(StepError, match=words):
            capture(tmp_path / name, tmp_path / "out", environment)
    with pytest.raises(StepError, match="0 samples"):
        capture(box, tmp_path / "out", environment, samples=0)
    assert not (tmp_path / "out").exists()


def test_a_real_scene_agrees_with_the_ray_caster(blender, tmp_path):
    write_demo_object("mug", tmp_path / "model")
    model = tmp_path / "model/model.ply"
    blenderproc.capture(model, "su_h", 128, 96, 0, 4, blender, 2, tmp_path / "blender")
    raycast.capture(model, "su_h", 128, 96, 0, tmp_path / "ray")
    for camera in read_sparse_model(tmp_path / "ray/truth").cameras:
        mask, ray_mask = (read_mask(tmp_path / name / "masks" / camera.name) for name in ("blender", "ray"))
        depth, ray_depth = (read_depth_mm(tmp_path / name / "depth" / camera.name) for name in ("blender", "ray"))
        image, ray_image = (read_image(tmp_path / name / "images" / camera.name).mean(2) for name in ("blender", "ray"))
        both, neither = mask & ray_mask, ~mask & ~ray_mask
        assert both.sum() > 0.97 * (mask | ray_mask).sum()
        assert np.median(np.abs(depth - ray_depth)[both]) < 0.15
        assert np.median(np.abs(depth - ray_depth)[(depth > 0) & (ray_depth > 0)]) < 0.5
        for where in (both, neither):
            assert image[where].mean() == pytest.approx(ray_image[where].mean(), rel=0.12)
            assert np.corrcoef(image[where], ray_image[where])[0, 1] > 0.8
