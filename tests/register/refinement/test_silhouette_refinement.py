"""Cameras that are bent are straightened by the outlines of the masks; wrong masks do not bend right cameras."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.bent_cameras import bend, make_views, model_of
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_MISSED_PX, carry_plane, straighten_cameras


@pytest.fixture(scope="module")
def made():
    return make_views()


def test_bent_cameras_are_straightened(made, tmp_path):
    bent = bend(made.cameras, 4.0)
    found = straighten_cameras(model_of(tmp_path / "sparse", bent, made.cameras, 150, 3), bent, made.masks)
    before_mm, after_mm = (compare_cameras(cameras, made.cameras).centre_mm.mean() for cameras in (bent, found.cameras))
    assert found.before_px > MOST_MISSED_PX > found.missed_px
    assert after_mm < 0.3 * before_mm, (before_mm, after_mm)
    placed = {image.name: image.cam_from_world().matrix() for image in found.model.images.values()}
    for camera in found.cameras:
        np.testing.assert_allclose(placed[camera.name], camera.camera_from_world[:3], atol=1e-9)


def test_wrong_masks_do_not_bend_right_cameras(made, tmp_path):
    """All masks take something along on one side, each on another; many matches hold the cameras."""
    grown = [mask | np.roll(mask, (-1) ** number * 12, number // 2 % 2) for number, mask in enumerate(made.masks)]
    found = straighten_cameras(model_of(tmp_path / "sparse", made.cameras, made.cameras, 300, 4), made.cameras, grown)
    assert found.missed_px > MOST_MISSED_PX and found.before_px is None
    assert found.cameras is made.cameras


def test_right_cameras_stay_as_they_are(made, tmp_path):
    model = model_of(tmp_path / "sparse", made.cameras, made.cameras, 10, 3)
    found = straighten_cameras(model, made.cameras, made.masks)
    assert found.model is model and found.cameras is made.cameras and found.missed_px < MOST_MISSED_PX


def test_a_plane_is_carried_along_with_the_cameras(made):
    """Cameras in another frame and of another scale: a point of the plane stays on it."""
    turn = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    scale, shift = 1.7, np.array([5.0, -3.0, 8.0])
    moved = []
    for camera in made.cameras:
        pose = camera.camera_from_world.copy()
        pose[:3, :3] = pose[:3, :3] @ turn.T
        pose[:3, 3] = -pose[:3, :3] @ (scale * turn @ camera.centre_in_world + shift)
        moved.append(replace(camera, camera_from_world=pose))
    normal = np.array([0.0, 0.6, 0.8])
    carried, offset = carry_plane(normal, 12.0, made.cameras, moved)
    on_plane = 12.0 * normal + np.array([7.0, 0.8, -0.6])
    assert carried @ (scale * turn @ on_plane + shift) == pytest.approx(offset)
