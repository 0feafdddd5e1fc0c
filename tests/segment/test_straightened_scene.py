"""Bent cameras are adjusted to what a network sees in each photo, before masks are found anew."""

import numpy as np
import pytest

from helpers.bent_cameras import bend, make_views, model_of
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.cameras.sparse_files import write_reconstruction
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.segment.straightened_scene import ERROR_GROWTH, FOUND_ERROR_GROWTH, FOUND_LEFT_SHARE, LEFT_SHARE, straighten_scene


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


def straighten(tmp_path, views, masks):
    return straighten_scene(tmp_path / "scene", views, masks, LEFT_SHARE, ERROR_GROWTH, tmp_path / "straight")


def test_bent_cameras_are_straightened(made, tmp_path):
    bent = bend(made.cameras, 4.0)
    views = write_scene(tmp_path / "scene", made, bent)
    assert straighten(tmp_path, views, made.masks)
    found = [view.camera for view in read_views(tmp_path / "straight")[0]]
    before_mm, after_mm = (compare_cameras(tuple(cameras), made.cameras).centre_mm.mean() for cameras in (bent, found))
    assert after_mm < 0.3 * before_mm and (tmp_path / "straight/registration.json").is_file()


@pytest.mark.parametrize("wrong", ["masks of something else", "nothing"])
def test_wrong_masks_change_nothing(made, tmp_path, wrong):
    nothing = np.zeros_like(made.masks[0])
    masks = [np.roll(mask, (-1) ** n * 60, n % 2) if wrong != "nothing" else nothing for n, mask in enumerate(made.masks)]
    views = write_scene(tmp_path / "scene", made, made.cameras)
    assert not straighten(tmp_path, views, masks)
    assert not (tmp_path / "straight").exists()


def test_matches_must_agree_with_masks_that_were_found(made, tmp_path):
    """Masks that lack a part in half of the photos draw cameras a little away from the matches."""
    masks = [
        mask & (np.arange(len(mask)) > np.flatnonzero(mask.any(1))[0] + 12)[:, None] if n % 2 else mask for n, mask in enumerate(made.masks)
    ]
    views = write_scene(tmp_path / "scene", made, made.cameras)
    assert not straighten_scene(tmp_path / "scene", views, masks, FOUND_LEFT_SHARE, FOUND_ERROR_GROWTH, tmp_path / "straight")


def test_right_cameras_are_left_alone(made, tmp_path):
    assert not straighten(tmp_path, write_scene(tmp_path / "scene", made, made.cameras), made.masks)
