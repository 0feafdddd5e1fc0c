"""Cameras of a pass that was not segmented."""

import pytest

from helpers.carton_scene import camera_at
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.runtime.files import write_json


@pytest.fixture
def carton_cameras_without_masks(tmp_path):
    folder = tmp_path / "cameras"
    write_cameras(folder / "sparse", [camera_at(f"{index:06d}.png", 36.0 * index, 30.0) for index in range(5)])
    (folder / "images").mkdir()
    write_json(folder / "registration.json", {"status": "ok", "images": 5})
    return folder
