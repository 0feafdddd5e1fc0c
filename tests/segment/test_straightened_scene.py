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


def straighten(monkeypatch, tmp_path, views, seen, found=None):
    """`seen` by the network, `found` with the cameras; nothing where they are None."""
    nothing = [np.zeros((view.camera.height_px, view.camera.width_px), bool) for view in views]
    seen, found = ({view.camera.name: mask for view, mask in zip(views, masks or nothing, strict=True)} for masks in (seen, found))
    monkeypatch.setattr(straightened_scene, "see_things", lambda views, network: seen)
    return straighten_scene(tmp_path / "scene", views, found, object(), tmp_path / "straight")


def cut_off(masks):
    """Masks that lack a part in half of the photos."""
    return [mask & (np.arange(len(mask)) > np.flatnonzero(mask.any(1))[0] + 12 * (n % 2))[:, None] for n, mask in enumerate(masks)]


@pytest.mark.parametrize("by", ["network", "found masks"])
def test_bent_cameras_are_straightened(made, tmp_path, monkeypatch, by):
    bent = bend(made.cameras, 4.0)
    views = write_scene(tmp_path / "scene", made, bent)
    masks = (made.masks, None) if by == "network" else (None, made.masks)
    assert straighten(monkeypatch, tmp_path, views, *masks)
    found = [view.camera for view in read_views(tmp_path / "straight")[0]]
    before_mm, after_mm = (compare_cameras(tuple(cameras), made.cameras).centre_mm.mean() for cameras in (bent, found))
    assert after_mm < 0.3 * before_mm and (tmp_path / "straight/registration.json").is_file()


@pytest.mark.parametrize("wrong", ["something else", "nothing", "all but a part"])
def test_wrong_masks_change_nothing(made, tmp_path, monkeypatch, wrong):
    other = [np.roll(mask, (-1) ** n * 60, n % 2) for n, mask in enumerate(made.masks)]
    masks = {"something else": other, "nothing": None, "all but a part": cut_off(made.masks)}[wrong]
    views = write_scene(tmp_path / "scene", made, made.cameras)
    assert not straighten(monkeypatch, tmp_path, views, masks, masks)
    assert not (tmp_path / "straight").exists()


def test_right_cameras_are_left_alone(made, tmp_path, monkeypatch):
    views = write_scene(tmp_path / "scene", made, made.cameras)
    assert not straighten(monkeypatch, tmp_path, views, list(made.masks), list(made.masks))
