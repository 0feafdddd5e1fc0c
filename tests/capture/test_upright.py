"""Quarter turns: the turned lens and pose see a point where the turned image shows it."""

import numpy as np
import pytest

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.capture.upright import count_quarter_turns, turn_lens, turn_pose
from zeroshop_steps.geometry.cameras.viewpoints import look_at

LENSES = [
    Lens("PINHOLE", 640, 480, (600.0, 610.0, 310.0, 250.0)),
    Lens("SIMPLE_RADIAL", 640, 480, (600.0, 310.0, 250.0, 0.05)),
    Lens("OPENCV", 640, 480, (600.0, 610.0, 310.0, 250.0, 0.05, -0.02, 0.003, -0.002)),
    Lens("FULL_OPENCV", 640, 480, (600.0, 610.0, 310.0, 250.0, 0.05, -0.02, 0.003, -0.002, 0.01, 0.02, 0.0, 0.0)),
    Lens("OPENCV_FISHEYE", 640, 480, (600.0, 610.0, 310.0, 250.0, 0.05, -0.02, 0.003, -0.002)),
]


def see(lens: Lens, world_from_camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    camera_from_world = np.linalg.inv(world_from_camera)
    return np.asarray(lens.to_colmap().img_from_cam(points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]))


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turned_lens_sees_points_where_the_turned_image_has_them(lens: Lens, turns: int) -> None:
    pose = np.linalg.inv(look_at(np.array([0.4, 0.1, 0.2]), np.zeros(3)))
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (30, 3))
    before = see(lens, pose, points)
    image = np.zeros((lens.height_px, lens.width_px), int)
    for number, (column, row) in enumerate(np.floor(before).astype(int), 1):
        image[row, column] = number
    turned = np.rot90(image, turns)
    lens_after = turn_lens(lens, turns)
    assert turned.shape == (lens_after.height_px, lens_after.width_px)
    after = np.floor(see(lens_after, turn_pose(pose, turns), points)).astype(int)
    numbers = np.array([turned[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].max() for column, row in after])
    assert (numbers >= 1).all() and np.mean(numbers == np.arange(1, 31)) > 0.9  # rounding, and points that share a pixel


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_view_is_turned_back(turns: int) -> None:
    upright = np.linalg.inv(look_at(np.array([0.4, 0.1, 0.2]), np.zeros(3)))
    rolled = turn_pose(upright, turns)
    needed = count_quarter_turns(LENSES[0], rolled)
    np.testing.assert_allclose(turn_pose(rolled, needed), upright, atol=1e-9)


def test_four_turns_are_none_and_unknown_lenses_stay() -> None:
    for lens in LENSES:
        assert turn_lens(turn_lens(lens, 3), 1) == lens
    rolled = turn_pose(np.linalg.inv(look_at(np.array([0.4, 0.1, 0.2]), np.zeros(3))), 2)
    assert count_quarter_turns(Lens("THIN_PRISM_FISHEYE", 640, 480, (1.0,) * 12), rolled) == 0


def test_a_camera_that_looks_straight_down_is_left_as_it_is() -> None:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, :3] = pose[:3, :3] @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert count_quarter_turns(LENSES[0], pose) == 0
