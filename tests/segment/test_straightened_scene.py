"""Bent cameras are adjusted to what a network sees in each photo, before masks are found anew."""

import numpy as np
import pytest

from helpers.bent_cameras import bend, make_views, model_of
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.segment import straightened_scene
from zeroshop_steps.segment.straightened_scene import straighten_scene


@pytest.fixture(scope="module")
def made():
    return make_views()


def write_scene(folder, made, cameras):
    """A registration of these cameras, with its photos."""
    write_reconstruction(model_of(folder / "sparse", cameras, made.cameras, 150, 3), folder / "sparse")
    for camera in cameras:
        write_image(folder / "images" / camera.name, np.zeros((camera.height_px, camera.width_px, 3), np.uint8))
    (folder / "registration.json").write_text("{}")
    return read_views(folder)[0]


def see(monkeypatch, masks):
    monkeypatch.setattr(straightened_scene, "find_object_maps", lambda network, images: [mask.astype(np.float32) for mask in masks])


def test_bent_cameras_are_straightened(made, tmp_path, monkeypatch):
    see(monkeypatch, made.masks)
    bent = bend(made.cameras, 4.0)
    views = write_scene(tmp_path / "scene", made, bent)
    assert straighten_scene(tmp_path / "scene", views, None, tmp_path / "straight")
    found = [view.camera for view in read_views(tmp_path / "straight")[0]]
    before_mm, after_mm = (compare_cameras(tuple(cameras), made.cameras).centre_mm.mean() for cameras in (bent, found))
    assert after_mm < 0.3 * before_mm and (tmp_path / "straight/registration.json").is_file()


@pytest.mark.parametrize("wrong", ["masks of something else", "nothing"])
def test_wrong_masks_change_nothing(made, tmp_path, monkeypatch, wrong):
    nothing = np.zeros_like(made.masks[0])
    see(monkeypatch, [np.roll(mask, (-1) ** n * 60, n % 2) if wrong != "nothing" else nothing for n, mask in enumerate(made.masks)])
    views = write_scene(tmp_path / "scene", made, made.cameras)
    assert not straighten_scene(tmp_path / "scene", views, None, tmp_path / "straight")
    assert not (tmp_path / "straight").exists()


def test_right_cameras_are_left_alone(made, tmp_path, monkeypatch):
    see(monkeypatch, made.masks)
    assert not straighten_scene(tmp_path / "scene", write_scene(tmp_path / "scene", made, made.cameras), None, tmp_path / "straight")
