"""The camera matrix of goals, from the messages of ROS 1 and ROS 2."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from zeroshop_steps.robot.goal_camera import FixedCamera, read_camera_info, read_lens
from zeroshop_steps.runtime.errors import StepError

MATRIX = [538.391, 0, 315.307, 0, 538.085, 233.048, 0, 0, 1]


@pytest.mark.parametrize("name", ["K", "k"])
def test_the_matrix_is_read_row_by_row(name):
    message = SimpleNamespace(width=640, height=480, **{name: MATRIX})
    assert read_camera_info(message, 640, 480).tolist() == np.array(MATRIX).reshape(3, 3).tolist()
    assert np.array_equal(read_camera_info(message, 640, 480), FixedCamera(538.391, 538.085, 315.307, 233.048).intrinsics_of(640, 480))


K = np.array([[100.0, 0, 64], [0, 100, 48], [0, 0, 1]])
BENT = [("plumb_bob", [-0.2, 0.05, 0, 0, 0]), ("rational_polynomial", [-0.2, 0.05, 0, 0, 0, 0, 0, 0]), ("equidistant", [0.1, 0.05, 0, 0])]


def camera_message(model: str, coefficients: list[float], **changes: object) -> SimpleNamespace:
    return SimpleNamespace(width=128, height=96, K=K.ravel(), D=coefficients, distortion_model=model, **changes)


@pytest.mark.parametrize(("model", "coefficients"), BENT)
def test_distortion_is_undone(model, coefficients):
    """A dot that the bent lens sees elsewhere comes back to where a straight one sees it, also in depth."""
    ray = np.array([0.45, -0.3, 1.0])
    fisheye = model == "equidistant"
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    place, _ = project(ray.reshape(1, 1, 3), np.zeros(3), np.zeros(3), K, np.array(coefficients))
    (x, y), (true_x, true_y) = place.ravel(), (K @ ray)[:2]
    assert np.hypot(x - true_x, y - true_y) > 2
    columns, rows = np.meshgrid(np.arange(128), np.arange(96))
    dot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 8)
    lens = read_lens(camera_message(model, coefficients), 128, 96, False)
    photo = lens.undistort((255 * dot[..., None] * np.ones(3)).astype(np.uint8))
    depth = lens.undistort(np.where(dot > 0.5, 700, 900).astype(np.float32))
    assert np.hypot(*(np.array(np.unravel_index(photo[..., 0].argmax(), (96, 128)))[::-1] - (true_x, true_y))) < 1
    assert depth[round(true_y), round(true_x)] == 700 and set(np.unique(depth)) <= {0, 700, 900}
    with pytest.raises(StepError, match="has a distortion.*rectified images.*--intrinsics"):
        read_camera_info(camera_message(model, coefficients), 128, 96)


def test_rectified_images_are_left_alone_and_have_another_matrix():
    projection = np.array([[90.0, 0, 60, 0], [0, 90, 50, 0], [0, 0, 1, 0]])
    lens = read_lens(camera_message(*BENT[0], P=projection.ravel()), 128, 96, True)
    assert lens.maps is None and lens.intrinsics.tolist() == projection[:, :3].tolist()
    assert read_lens(camera_message("plumb_bob", [1e-5, 0, 0, 0, 0]), 128, 96, False).maps is None, "not seen"
    with pytest.raises(StepError, match="distortion 'thin_prism' with 5 coefficients; expected finite numbers of plumb_bob \\(4 or 5\\)"):
        read_lens(camera_message("thin_prism", [1.0] * 5), 128, 96, False)
    with pytest.raises(StepError, match="expected finite numbers"):
        read_lens(camera_message("plumb_bob", [np.nan] * 5), 128, 96, False)


@pytest.mark.parametrize("part", [{"binning_x": 2, "binning_y": 2}, {"roi": SimpleNamespace(x_offset=8, y_offset=0, width=120, height=96)}])
def test_images_of_a_part_of_the_sensor_are_refused(part):
    with pytest.raises(StepError, match="cut out or binned"):
        read_lens(camera_message("plumb_bob", [0.0] * 5, **part), 128, 96, False)
    whole = {"binning_x": 0, "binning_y": 1, "roi": SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)}
    assert np.array_equal(read_lens(camera_message("plumb_bob", [0.0] * 5, **whole), 128, 96, False).intrinsics, K)


@pytest.mark.parametrize(
    ("width", "matrix", "reason"),
    [
        (1280, MATRIX, "about images of 1280 x 480 px, the images have 640 x 480 px"),
        (640, [0] * 9, "no focal length"),
        (640, [500, 0, 320, 0, 0, 240, 0, 0, 1], "no focal length"),
        (640, [np.inf, 0, 320, 0, 500, 240, 0, 0, 1], "no focal length"),
        (640, [500, 0, 0, 0, 500, 0, 320, 240, 1], r"the matrix K = \[500.0, .*; expected fx, 0, cx, 0, fy, cy, 0, 0, 1 row by row"),
        (640, [500, 0, 0, 0, 500, 0, 0, 0, 1], "with cx and cy in the image"),
        (640, [np.nan] * 9, "no number"),
    ],
)
def test_another_or_no_camera_is_refused(width, matrix, reason):
    with pytest.raises(StepError, match=reason):
        read_camera_info(SimpleNamespace(width=width, height=480, K=matrix), 640, 480)
