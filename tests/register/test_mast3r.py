"""Registration by MASt3R: its back end finds the true cameras from what a perfect network with noise would say."""

import numpy as np
import pytest

from helpers.made_pairs import MadePairs, Noise
from helpers.made_scene import MadeScene, made_scene
from zeroshop_steps.geometry.cameras.pinhole import fit_similarity, read_sparse_model
from zeroshop_steps.register.mast3r import Mast3rOptions, register
from zeroshop_steps.register.pipeline import StructureOptions
from zeroshop_steps.register.scene.record import RegistrationFailed

VIEWS = 8
AZIMUTHS_DEG = [360.0 / VIEWS * number for number in range(VIEWS)]
WIDTH_PX = 192
ELEVATIONS_DEG = [40.0 if number % 2 else 25.0 for number in range(VIEWS)]


@pytest.fixture(scope="module")
def scene():
    return made_scene(AZIMUTHS_DEG, ELEVATIONS_DEG, width_px=WIDTH_PX, height_px=144)


def camera_errors(scene, sparse):
    """Distances of the camera centres from the true ones in mm, and angles between the axes in degrees, after a similarity."""
    found = {camera.name: camera for camera in read_sparse_model(sparse).cameras}
    true = np.array([camera.centre_in_world for camera in scene.cameras])
    world = fit_similarity(np.array([found[camera.name].centre_in_world for camera in scene.cameras]), true)
    rotation = world[:3, :3] / np.cbrt(np.linalg.det(world[:3, :3]))
    distances, angles = [], []
    for camera in scene.cameras:
        other = found[camera.name]
        distances.append(np.linalg.norm(world[:3, :3] @ other.centre_in_world + world[:3, 3] - camera.centre_in_world))
        cosine = (other.camera_from_world[2, :3] @ rotation.T) @ camera.camera_from_world[2, :3]
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return np.array(distances), np.array(angles)


@pytest.mark.slow
def test_true_depth_with_noise_gives_the_true_cameras(scene, tmp_path):
    image_set = scene.image_set(tmp_path)
    out = tmp_path / "cameras"
    out.mkdir()
    figures = register(image_set, out, Mast3rOptions(min_track=3), lambda: MadePairs(scene.cameras, scene.depths, 1e-3, Noise(), WIDTH_PX))
    assert figures["registered"] == VIEWS and figures["matched_pairs"] > 16
    distances, angles = camera_errors(scene, out / "sparse")
    # The cameras stand 700 mm away; a pixel is 2.6 mm there.
    assert distances.mean() < 2.0 and angles.max() < 0.3, (distances, angles)
    assert len(list((out / "images").iterdir())) == len(list((out / "masks").iterdir())) == VIEWS


def test_pictures_without_overlap_are_a_failure_with_its_reason(scene, tmp_path):
    scene = MadeScene(scene.cameras[:3], scene.depths[:3], scene.masks[:3])
    image_set = scene.image_set(tmp_path)
    strangers = MadePairs(scene.cameras, [np.zeros_like(depth) for depth in scene.depths], 1e-3, Noise(), WIDTH_PX)
    (tmp_path / "cameras").mkdir()
    with pytest.raises(RegistrationFailed, match="finds no matches"):
        register(image_set, tmp_path / "cameras", Mast3rOptions(structure=StructureOptions(min_images=3)), lambda: strangers)
