"""Cameras that are bent are straightened by the outlines of the masks; wrong masks do not bend right cameras."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from helpers.made_scene import SIZE_MM, made_scene
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.register.refinement.silhouette_refinement import MOST_MISSED_PX, carry_plane, straighten_cameras

VIEWS = 10


@pytest.fixture(scope="module")
def made():
    return made_scene([360.0 / VIEWS * number for number in range(VIEWS)], [20.0, 50.0] * (VIEWS // 2), width_px=480, height_px=360)


def bend(cameras, degrees):
    """Turn each camera about the object's middle, ever farther around it and back."""
    middle = np.array([0.0, 0.0, SIZE_MM[2] / 2])
    bent = []
    for number, camera in enumerate(cameras):
        turn = Rotation.from_rotvec(
            np.radians(degrees) * np.array([np.sin(2.1 * number), np.cos(1.3 * number), np.sin(number)])
        ).as_matrix()
        pose = camera.camera_from_world.copy()
        pose[:3, 3] += pose[:3, :3] @ (middle - turn @ middle)
        pose[:3, :3] = pose[:3, :3] @ turn
        bent.append(replace(camera, camera_from_world=pose))
    return bent


def model_of(folder, cameras, true, count, neighbours, noise_px=0.3):
    """A COLMAP model of these cameras, whose points are where the true cameras see points of the carton."""
    write_cameras(folder, cameras)
    model, rng = read_reconstruction(folder), np.random.default_rng(0)
    images = {image.name: image for image in model.images.values()}
    points = rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 1.0], (count, 3)) * SIZE_MM
    seen = {camera.name: camera.project(points)[0] + rng.normal(0, noise_px, (count, 2)) for camera in true}
    first = rng.integers(0, VIEWS, count)
    for name, image in images.items():
        image.points2D = [pycolmap.Point2D(pixel) for pixel in seen[name]]
    for index, point in enumerate(points):
        track = pycolmap.Track()
        for step in range(neighbours):
            track.add_element(images[true[(first[index] + step) % VIEWS].name].image_id, index)
        model.add_point3D(point, track, np.zeros(3, np.uint8))
    return model


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
