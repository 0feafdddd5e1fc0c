"""Carving the visual hull by depths, where the truth is known in closed form."""

import numpy as np

from helpers.cup import FLOOR, HALF, RESOLUTION, RIM, WALL, camera_above, cup, depth_of_cup, full_hull
from zeroshop_steps.geometry.observation.visual_hull import voxel_centres
from zeroshop_steps.surface.mvs.free_space import HullDistanceField, carve_free_space


def test_a_few_confirmed_depths_open_a_hollow_and_spare_its_walls() -> None:
    cameras = [camera_above(azimuth) for azimuth in range(0, 360, 45)]
    rng = np.random.default_rng(0)
    sparse = [np.where(rng.random((120, 120)) < 0.15, depth_of_cup(camera), 0).astype(np.float32) for camera in cameras]
    volume = carve_free_space(full_hull(), cameras, sparse)
    points = voxel_centres(HALF, RESOLUTION)
    truth, found = cup(points), volume.occupied.ravel()
    assert (found & truth).sum() / (found | truth).sum() > 0.85
    radius = np.hypot(points[:, 0], points[:, 1])
    hollow = (radius < WALL - 0.1) & (points[:, 2] > FLOOR + 0.15) & (points[:, 2] < RIM)
    assert not found[hollow].any(), "the lid and what lies under it must go"


def test_without_depths_the_hull_stays_and_one_wrong_view_opens_nothing() -> None:
    hull = full_hull()
    cameras = [camera_above(azimuth) for azimuth in range(0, 360, 45)]
    nothing = [np.zeros((120, 120), np.float32) for _ in cameras]
    untouched = carve_free_space(hull, cameras, nothing).occupied
    assert (untouched != hull.occupied).mean() < 0.02, "only sharp edges may be rounded"
    wrong = [np.full((120, 120), 5.0, np.float32), *nothing[1:]]
    assert np.array_equal(carve_free_space(hull, cameras, wrong).occupied, untouched)


def test_distance_from_the_volume() -> None:
    volume = HullDistanceField.from_hull(full_hull())
    voxel = 2 * HALF / RESOLUTION
    points = np.array([[0.0, 0.0, 0.0], [0.65 + 2 * voxel, 0, 0], [0.65 + 6 * voxel, 0, 0], [5.0, 0, 0]])
    assert volume.farther_than(points, 3.5).tolist() == [False, False, True, True]
