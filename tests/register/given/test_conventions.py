"""Usual faults of given poses are found by matches that know of no poses, and named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.given import given_cameras, small_ring
from zeroshop_steps.geometry.cameras.transforms import OPENCV_FROM_OPENGL
from zeroshop_steps.register.given.conventions import PairMatches, find_fault, list_readings, measure_support

NAMES = [f"{number:06d}.png" for number in range(12)]


def match(cameras) -> list[PairMatches]:
    """Matches of neighbours, a third of a pixel off, a tenth of them false."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-60, 60, (80, 3))
    rays = []
    for camera in cameras:
        inside = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
        rays.append(inside[:, :2] / inside[:, 2:] + rng.normal(0, 0.3 / 300, (80, 2)))
        rays[-1][rng.permutation(80)[:4]] = rng.uniform(-0.2, 0.2, (4, 2))
    numbers = [(one, other) for one in range(12) for other in range(one + 1, 12) if min(other - one, one + 12 - other) <= 4]
    return [PairMatches(NAMES[one], NAMES[other], rays[one], rays[other], 160 / 300 / 1000) for one, other in numbers]


@pytest.fixture(scope="module")
def pairs() -> list[PairMatches]:
    return match(small_ring())


@pytest.fixture
def poses():
    return given_cameras(small_ring(), 0.001, 0.3).poses


def each(change, poses):
    return {name: change(pose) for name, pose in poses.items()}


def test_right_poses_have_no_fault_even_with_the_noise_of_an_arm(poses, pairs):
    support, fault = find_fault(poses, pairs, NAMES)
    assert fault is None and support > 0.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda pose: OPENCV_FROM_OPENGL @ pose, "OpenGL's axes"),
        (np.linalg.inv, "invert each"),
        (lambda pose: np.linalg.inv(OPENCV_FROM_OPENGL @ pose), "world_from_camera with OpenGL's axes"),
    ],
)
def test_wrong_axes_and_inverses_are_named(poses, pairs, change, said):
    fault = find_fault(each(change, poses), pairs, NAMES)[1]
    assert fault and said in fault


def test_poses_that_are_late_are_named_by_their_frames():
    """The way of a hand, now slow, now fast, not an even ring, whose cameras look alike one further on."""
    ring = small_ring(40)
    way = [replace(ring[place], name=name) for place, name in zip((0, 3, 4, 9, 10, 16, 17, 24, 25, 29, 36, 37), NAMES, strict=True)]
    exact = given_cameras(way).poses
    late = {name: exact[NAMES[max(number - 1, 0)]] for number, name in enumerate(NAMES)}
    assert find_fault(exact, match(way), NAMES)[1] is None
    fault = find_fault(late, match(way), NAMES)[1]
    assert fault and "1 frame late" in fault


def test_a_missing_hand_eye_transform_is_told_from_poses_of_another_film(poses, pairs):
    hand = np.eye(4)
    hand[:3, :3], hand[:3, 3] = Rotation.from_euler("xyz", [40, -20, 90], degrees=True).as_matrix(), (0.05, 0.02, -0.08)
    fault = find_fault(each(lambda pose: hand @ pose, poses), pairs, NAMES)[1]
    assert fault and "hand-eye" in fault
    turned = np.random.default_rng(3).permutation(NAMES)
    fault = find_fault({name: poses[other] for name, other in zip(NAMES, turned, strict=True)}, pairs, NAMES)[1]
    assert fault and "another recording" in fault


def test_without_matches_nothing_is_said(poses, pairs):
    assert find_fault(poses, pairs[:1], NAMES) == (None, None)


def test_each_reading_of_axes_is_undone_by_itself(poses, pairs):
    """Reading a fault twice gives back what was stated."""
    support = measure_support(poses, pairs)
    for reading in list_readings(NAMES)[:2]:
        assert measure_support(reading.read(reading.read(poses)), pairs) == pytest.approx(support)
