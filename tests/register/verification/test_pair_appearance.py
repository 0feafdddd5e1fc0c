"""Pairs of images count where the pictures show the same between their matches, and not where only the matches agree."""

import cv2
import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from helpers.two_faced_can import can_with_two_faces
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.register.matching.network_matches import write_matches
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.verification.pair_appearance import compare_between, delete_inconsistent_pairs

VIEWS = 24
FRONT, BESIDE, BACK = 0, 1, 12


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Front, the view beside it, and the back of the can; for each the pixels of 300 points of the front, as if the can were turned."""
    folder = tmp_path_factory.mktemp("can")
    renderer = MeshRenderer(can_with_two_faces())
    rng = np.random.default_rng(0)
    turns, heights = rng.uniform(-0.9, 0.9, 300), rng.uniform(-45, 45, 300)
    cameras = {number: ring_camera(number, VIEWS, 320, (20, 20), (0, 0, 0), 500, (320, 240)) for number in (FRONT, BESIDE, BACK)}
    towards = np.arctan2(*cameras[FRONT].centre_in_world[[1, 0]])
    pixels = {}
    for number, camera in cameras.items():
        write_image(folder / "images" / f"{number:06d}.png", renderer.render_color(camera, (120, 120, 120)))
        write_mask(folder / "masks" / f"{number:06d}.png", renderer.cast_rays(camera).mask)
        angles = turns + towards + (np.pi if number == BACK else 0.0)
        points = np.stack([35 * np.cos(angles), 35 * np.sin(angles), heights], 1)
        pixels[number] = camera.project(points)[0]
    return folder, pixels


def test_the_back_does_not_show_what_the_front_shows(capture, tmp_path):
    folder, pixels = capture
    image_set = read_image_set(folder)
    numbers = np.arange(300)
    matches = {(0, 1): (numbers, numbers), (0, 2): (numbers, numbers)}
    write_matches(tmp_path / "database.db", image_set, list(pixels.values()), matches, 2, 0, 500.0)
    assert delete_inconsistent_pairs(tmp_path / "database.db", image_set) == [("000000.png", "000012.png")]


def test_a_picture_is_like_itself_and_not_like_noise():
    rng = np.random.default_rng(1)
    grey = cv2.GaussianBlur(rng.uniform(0, 255, (200, 240)).astype(np.float32), (0, 0), 2.0)
    other = cv2.GaussianBlur(rng.uniform(0, 255, (200, 240)).astype(np.float32), (0, 0), 2.0)
    mask = np.ones(grey.shape, bool)
    points = rng.uniform([5, 5], [235, 195], (200, 2))
    same = compare_between(grey, mask, points, grey, mask, points)
    unlike = compare_between(grey, mask, points, other, mask, points)
    assert len(same) > 100 and np.median(same) > 0.99 and np.median(unlike) < 0.6


def test_points_on_a_line_span_nothing():
    grey, mask = np.zeros((50, 50), np.float32), np.ones((50, 50), bool)
    line = np.stack([np.arange(10.0), np.arange(10.0)], 1)
    assert len(compare_between(grey, mask, line, grey, mask, line)) == 0
