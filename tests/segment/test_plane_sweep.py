"""A plane sweep tells print on the ground from a thing above it, and says nothing of what has no print."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.segment.quality.plane_sweep import shrink, sweep

SIZE, FOCAL, DISTANCE, COUNT = (240, 180), 260.0, 4.0, 12
GROUND = SceneSupport(np.array([0.0, 0.0, 1.0]), 0.0, np.zeros(3), DISTANCE, 1)
RAISED = 0.6  # height of a square above the ground


def draw(camera, prints):
    """What a camera sees of squares, each at its height: (height, half its side, (N, N) grey); later ones lie above."""
    image = np.full(SIZE[::-1], 128.0, np.float32)
    for height, half, grey in prints:
        world_from_texel = np.zeros((4, 3))
        step = 2 * half / len(grey)
        world_from_texel[:3] = np.array([[step, 0, -half + step / 2], [0, step, -half + step / 2], [0, 0, height]])
        world_from_texel[3, 2] = 1
        homography = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]]) @ camera.intrinsics @ camera.camera_from_world[:3] @ world_from_texel
        shown = cv2.warpPerspective(np.ones_like(grey), homography, SIZE) > 0.99
        image[shown] = cv2.warpPerspective(grey, homography, SIZE)[shown]
    return np.repeat(image[..., None], 3, 2)


@pytest.fixture(scope="module")
def cameras():
    return [ring_camera(index, COUNT, DISTANCE, (40, 55), (0.0, 0.0, 0.0), FOCAL, SIZE) for index in range(COUNT)]


def sweep_square(cameras, height, levels, cells=20):
    """(raised, elsewhere) within a square at this height above printed ground; contrast of its print, and cells of that along a side."""
    rng = np.random.default_rng(0)
    ground, square = (cv2.resize(rng.uniform(20, 236, (count, count)).astype(np.float32), (512, 512)) for count in (80, cells))
    square = 128 + (square - 128) * levels
    prints = [(0.0, 2.5, ground), (height, 0.5, square)]
    photos = [shrink(draw(camera, prints), camera) for camera in cameras]
    inside = draw(cameras[0], [(height, 0.35, np.full((8, 8), 255.0, np.float32))])[..., 0] > 250
    return [part[inside] for part in sweep(photos, 0, GROUND)]


def test_print_above_the_ground_is_raised(cameras):
    raised, elsewhere = sweep_square(cameras, RAISED, 1.0, cells=10)
    assert np.median(raised) > 0.8 and np.median(raised - elsewhere) > 0.3


def test_a_printed_sheet_on_the_ground_is_not(cameras):
    raised, elsewhere = sweep_square(cameras, 0.0, 1.0)
    assert np.median(elsewhere) > 0.9 and np.median(elsewhere - raised) > 0.3


def test_what_is_far_from_the_focus_is_not_raised(cameras):
    rng = np.random.default_rng(0)
    print_ = cv2.resize(rng.uniform(20, 236, (30, 30)).astype(np.float32), (512, 512))
    photos = [shrink(draw(camera, [(RAISED, 1.0, print_)]), camera) for camera in cameras]
    near, far = (sweep(photos, 0, replace(GROUND, focus=focus)) for focus in (np.zeros(3), np.array([30.0, 0, 0])))
    assert near[0].max() > 0.9 and not far[0].any()


def test_a_plain_surface_tells_nothing(cameras):
    raised, elsewhere = sweep_square(cameras, RAISED, 0.0)
    assert np.median(np.abs(raised - elsewhere)) < 0.2


def test_a_part_of_a_photo_is_swept_like_the_whole(cameras):
    grey = np.random.default_rng(1).uniform(20, 236, (40, 40)).astype(np.float32)
    photos = [shrink(draw(camera, [(0.0, 2.5, grey), (RAISED, 0.5, grey)]), camera) for camera in cameras]
    part, inner = (slice(30, 120), slice(60, 200)), (slice(4, -4), slice(4, -4))  # at its rim, the windows of the correlation end
    for whole, alone in zip(sweep(photos, 0, GROUND), sweep(photos, 0, GROUND, part), strict=True):
        assert np.allclose(whole[part][inner], alone[inner], atol=1e-3)
