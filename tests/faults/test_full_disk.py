"""A full disk: every writer of the project says so and leaves what was there before, on a real small file system."""

import os
import re
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from faults.photos import take_photos
from helpers.camera_ring import ring_camera
from helpers.faults import largest_file, small_disk, step
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.imaging.images import read_mask, write_image, write_mask
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.code_version import SOURCES
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, atomic_write, write_json
from zeroshop_steps.runtime.tables import write_table

ROOM_BYTES = 64 << 10
LARGE = 40_000  # numbers: more than the small disk holds, in every format
NOISE = np.random.default_rng(0).integers(0, 255, (400, 400, 3), np.uint8)


def write_savez(path: Path) -> None:
    with atomic_write(path) as temporary:
        np.savez_compressed(temporary, content=np.random.default_rng(0).random(LARGE))


def write_sparse_model(path: Path) -> None:
    with atomic_directory(path) as folder:
        write_cameras(
            folder / "sparse", [ring_camera(index, 600, 500.0, (20.0, 40.0), (0.0, 0.0, 0.0), 500.0, (640, 480)) for index in range(600)]
        )


WRITERS = {
    "picture.png": lambda path: write_image(path, NOISE),
    "picture.jpg": lambda path: write_image(path, NOISE.repeat(2, axis=0)),
    "mask.png": lambda path: write_mask(path, NOISE[..., 0].repeat(4, axis=0) > 128),
    "mesh.ply": lambda path: write_ply(path, Mesh(np.random.default_rng(0).random((LARGE, 3)), np.array([[0, 1, 2]]))),
    "record.json": lambda path: write_json(path, list(range(LARGE))),
    "table.csv": lambda path: write_table(path, pd.DataFrame({"value": np.arange(LARGE)})),
    "array.npz": write_savez,
    "cameras": write_sparse_model,
}


def fill(disk: Path) -> None:
    """Take every free byte."""
    with (disk / "filler").open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(512))
        except OSError:
            pass


@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_without_a_free_byte(name: str, tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", ROOM_BYTES) as disk:
        fill(disk)
        with pytest.raises(StepError, match=f"cannot write .*{name}.*Check free disk space"):
            WRITERS[name](disk / name)
        assert sorted(path.name for path in disk.iterdir()) == ["filler"]


@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_becomes_full(name: str, tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", ROOM_BYTES) as disk:
        with pytest.raises(StepError, match=f"cannot write .*{name}.*Check free disk space"):
            WRITERS[name](disk / name)
        assert list(disk.iterdir()) == []


@pytest.mark.parametrize("name", WRITERS)
def test_a_limit_on_the_size_of_files(name: str, tmp_path: Path) -> None:
    with largest_file(8192), pytest.raises(StepError, match=f"cannot write .*{name}.*ulimit -f"):
        WRITERS[name](tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_small_mask_on_a_full_disk_leaves_the_old_one(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", ROOM_BYTES) as disk:
        write_mask(disk / "mask.png", np.ones((4, 4), bool))
        fill(disk)
        with pytest.raises(StepError, match="No space left on device"):
            write_mask(disk / "mask.png", np.zeros((4, 4), bool))
        assert read_mask(disk / "mask.png").all()


def test_a_capture_of_photos_under_a_limit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = tmp_path / "photos"
    for index in range(9):
        blocks = np.random.default_rng(index).integers(0, 255, (24, 32, 3), dtype=np.uint8)
        write_image(photos / f"{index}.jpg", cv2.resize(blocks, (640, 480), interpolation=cv2.INTER_NEAREST))
    with largest_file(8192):
        assert step("capture", "photos", images=photos, out=tmp_path / "capture") == 1
    assert "ulimit -f" in capsys.readouterr().err
    assert sorted(os.listdir(tmp_path)) == ["photos"]


def test_a_registration_on_a_disk_that_becomes_full(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    take_photos(tmp_path, 640, 480).rename(tmp_path / "images")
    for room_bytes in (8 << 10, 64 << 10, 400 << 10):
        with small_disk(tmp_path / "disk", room_bytes) as disk:
            assert step("register", "colmap", capture=tmp_path, scene="video", out=disk / "cameras") == 1
            text = capfd.readouterr().err
            assert "Check free disk space" in text and "Traceback" not in text, (room_bytes, text)
            assert list(disk.iterdir()) == []


def test_no_module_lets_a_library_write_files_that_does_not_tell_of_a_full_disk() -> None:
    silent = re.compile(r"cv2\.imwrite|\.write_binary\(|o3d\.io\.write|\.save_current_mesh|torch\.save\(.*temporary")
    found = [path.name for path in SOURCES.rglob("*.py") if silent.search(path.read_text())]
    assert found == ["sparse_files.py"], "its files are measured after they are written"
