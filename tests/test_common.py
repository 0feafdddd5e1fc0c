"""What every step builds on: whole files or none, named errors, cameras, meshes."""

import errno
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import zeroshop_steps
from zeroshop_steps.geometry.cameras import Camera, read_sparse_model, similarity_between, write_cameras
from zeroshop_steps.geometry.images import list_images, read_depth_mm, read_image, read_mask, write_depth_mm, write_image, write_mask
from zeroshop_steps.geometry.meshes import Mesh, read_ply, write_ply
from zeroshop_steps.runtime.cli import stage_main, stage_methods
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import is_result
from zeroshop_steps.runtime.files import atomic_directory, atomic_write, read_json, write_json


def square(texture: bool = True) -> Mesh:
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [10, 20, 0], [0, 20, 0]])
    uv = vertices[:, :2] / [10, 20] if texture else None
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), uv=uv).with_normals()


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "product.json"
    write_json(target, {"a": 1})
    with pytest.raises(ValueError, match="boom"), atomic_write(target) as temporary:
        temporary.write_text("half")
        raise ValueError("boom")
    assert read_json(target) == {"a": 1} and [path.name for path in tmp_path.iterdir()] == ["product.json"]


def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(StepError, match=r"mesh.ply: No space left on device. Check free disk space"), atomic_write(tmp_path / "mesh.ply"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(StepError, match="No space left"), atomic_directory(tmp_path / "folder") as folder:
        (folder / "image.png").write_bytes(b"x")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_could_not_be_read_is_named(tmp_path: Path) -> None:
    message = r"cannot write .*mesh.ply: No such file or directory: .*absent.ply"
    with pytest.raises(StepError, match=message), atomic_write(tmp_path / "mesh.ply"):
        (tmp_path / "absent.ply").read_bytes()


def test_an_image_that_cannot_be_written_is_a_fault_of_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imwrite", lambda *_: False)
    with pytest.raises(StepError, match=r"cannot write .*a.png") as error:
        write_image(tmp_path / "a.png", np.zeros((2, 2, 3), np.uint8))
    assert not is_result(error.value)


def test_a_request_to_end_leaves_nothing_half_written(tmp_path: Path) -> None:
    (tmp_path / "stage").mkdir()
    (tmp_path / "stage/__init__.py").touch()
    (tmp_path / "stage/slow.py").write_text(
        "import time\n"
        "from pathlib import Path\n"
        "from zeroshop_steps.runtime.files import atomic_directory\n"
        "def add_arguments(parser): pass\n"
        "def run(args):\n"
        f"    with atomic_directory(Path({str(tmp_path / 'made/out')!r})) as folder:\n"
        "        (folder / 'half').touch()\n"
        "        print('writing', flush=True)\n"
        "        time.sleep(60)\n"
    )
    step = "import sys; from zeroshop_steps.runtime.cli import stage_main; sys.exit(stage_main('stage'))"
    command = [sys.executable, "-c", step, "--method", "slow"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout.readline() == "writing\n"
        process.terminate()
        assert "interrupted" in process.communicate()[1]
    assert process.returncode == 130 and list((tmp_path / "made").iterdir()) == []


def test_a_folder_is_replaced_whole(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "stale").touch()
    with atomic_directory(tmp_path / "out") as folder:
        (folder / "fresh").touch()
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["fresh"]


def test_damaged_json_is_named(tmp_path: Path) -> None:
    (tmp_path / "frame.json").write_text('{"a": ')
    with pytest.raises(StepError, match="frame.json is not valid JSON"):
        read_json(tmp_path / "frame.json")
    with pytest.raises(StepError, match="absent.json does not exist"):
        read_json(tmp_path / "absent.json")


NO_STAGES = ("runtime", "geometry")
STAGES = [found.name for found in pkgutil.iter_modules(zeroshop_steps.__path__) if found.ispkg and found.name not in NO_STAGES]


@pytest.mark.parametrize("stage", STAGES)
def test_every_method_of_a_stage_is_a_command(stage: str) -> None:
    methods = stage_methods(f"zeroshop_steps.{stage}")
    assert methods, "a stage without a method"
    for method in methods:
        module = importlib.import_module(f"zeroshop_steps.{stage}.{method}")
        assert callable(module.add_arguments) and callable(module.run) and module.__doc__


def test_an_unknown_method_lists_those_that_exist(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as stop:
        stage_main("zeroshop_steps.surface", ["--method", "nerf"])
    assert stop.value.code == 2 and "twodgs" in capsys.readouterr().err


def test_a_step_error_is_one_line_and_status_one(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    arguments = ["--method", "fuse", "--splats", f"{tmp_path}/none.ply", "--cameras", str(tmp_path), "--out", f"{tmp_path}/mesh.ply"]
    assert stage_main("zeroshop_steps.surface", arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and "none.ply does not exist" in error and "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_images_and_masks_say_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="does not exist"):
        list_images(tmp_path / "nowhere")
    with pytest.raises(StepError, match="holds no images"):
        list_images(tmp_path)
    (tmp_path / "broken.png").write_bytes(b"\x89PNG broken")
    with pytest.raises(StepError, match="broken.png cannot be read"):
        read_image(tmp_path / "broken.png")
    write_mask(tmp_path / "mask.png", np.eye(4, 6, dtype=bool))
    assert np.array_equal(read_mask(tmp_path / "mask.png", (6, 4)), np.eye(4, 6, dtype=bool))
    with pytest.raises(StepError, match="mask.png is 6 x 4 px, its image is 8 x 4 px"):
        read_mask(tmp_path / "mask.png", (8, 4))


def test_color_and_depth_survive_the_disk(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    write_image(tmp_path / "a.png", image)
    assert np.array_equal(read_image(tmp_path / "a.png"), image)
    depth_mm = np.array([[0.0, 123.4], [999.9, 6000.0]])
    write_depth_mm(tmp_path / "d.png", depth_mm)
    assert np.allclose(read_depth_mm(tmp_path / "d.png"), depth_mm, atol=0.051)


def test_a_mesh_survives_the_disk_and_other_readers(tmp_path: Path) -> None:
    import trimesh

    mesh = square()
    write_image(tmp_path / "t.png", np.full((4, 4, 3), 200, np.uint8))
    write_ply(tmp_path / "m.ply", mesh, "t.png")
    back = read_ply(tmp_path / "m.ply")
    assert np.array_equal(back.vertices, mesh.vertices) and np.array_equal(back.faces, mesh.faces)
    assert np.allclose(back.uv, mesh.uv) and np.allclose(back.normals, [[0, 0, 1]] * 4) and back.texture.shape == (4, 4, 3)
    assert len(trimesh.load(tmp_path / "m.ply", process=False).vertices) == 4


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_other_layouts_of_ply_read_alike(tmp_path: Path, encoding: str) -> None:
    import trimesh

    mesh = square(texture=False)
    write_ply(tmp_path / "ours.ply", mesh)
    other = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=np.full((4, 4), 90, np.uint8), process=False)
    (tmp_path / "other.ply").write_bytes(trimesh.exchange.ply.export_ply(other, encoding=encoding))
    ours, theirs = read_ply(tmp_path / "ours.ply"), read_ply(tmp_path / "other.ply")
    assert np.array_equal(ours.vertices, theirs.vertices) and np.array_equal(ours.faces, theirs.faces)


@pytest.mark.parametrize("damage", ["truncated", "text", "empty", "faces"])
def test_a_corrupted_ply_is_named(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "bad.ply"
    mesh = square(texture=False)
    write_ply(path, Mesh(mesh.vertices, mesh.faces + 7) if damage == "faces" else mesh)
    content = path.read_bytes()
    if damage != "faces":
        path.write_bytes({"truncated": content[:-9], "text": b"hello", "empty": b""}[damage])
    with pytest.raises(StepError, match="bad.ply"):
        read_ply(path)


def test_cameras_survive_the_disk(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1.0, 2.0, 3.0]
    camera = Camera("b.png", 640, 480, np.array([[500.0, 0, 320.5], [0, 510.0, 240.25], [0, 0, 1]]), pose)
    write_cameras(tmp_path / "sparse", [camera])
    back = read_sparse_model(tmp_path / "sparse").cameras[0]
    assert back.name == "b.png" and np.allclose(back.intrinsics, camera.intrinsics) and np.allclose(back.camera_from_world, pose)
    with pytest.raises(StepError, match="holds no readable COLMAP model"):
        read_sparse_model(tmp_path / "absent")


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 100.0))
def test_similarity_is_recovered_exactly(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    source, shift = rng.normal(size=(8, 3)), rng.normal(size=3) * 10
    found = similarity_between(source, scale * source @ rotation.T + shift)
    assert np.allclose(found[:3, :3], scale * rotation, atol=1e-9 * scale + 1e-12)
    assert np.allclose(found[:3, 3], shift, atol=1e-8 * (1 + scale))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_resized_cameras_see_the_same_rays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = Camera("a", 800, 600, np.array([[700.0, 0, 390], [0, 705, 310], [0, 0, 1]]), np.eye(4))
    points = np.concatenate([rng.uniform(-1, 1, (5, 2)), rng.uniform(2, 4, (5, 1))], 1)
    pixels, depths = camera.project(points)
    small, small_depths = camera.resized(400, 150).project(points)
    assert np.allclose(small, pixels * [0.5, 0.25]) and np.allclose(depths, small_depths)
