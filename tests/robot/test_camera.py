"""The camera matrix of goals, from the messages of ROS 1 and ROS 2."""

from types import SimpleNamespace

import numpy as np
import pytest

from zeroshop_steps.robot.camera import GivenCamera, read_camera_info
from zeroshop_steps.runtime.errors import StepError

MATRIX = [538.391, 0, 315.307, 0, 538.085, 233.048, 0, 0, 1]


@pytest.mark.parametrize("name", ["K", "k"])
def test_the_matrix_is_read_row_by_row(name):
    message = SimpleNamespace(width=640, height=480, **{name: MATRIX})
    assert read_camera_info(message, 640, 480).tolist() == np.array(MATRIX).reshape(3, 3).tolist()
    assert np.array_equal(read_camera_info(message, 640, 480), GivenCamera(538.391, 538.085, 315.307, 233.048).intrinsics_of(640, 480))


@pytest.mark.parametrize(
    ("width", "matrix", "reason"),
    [(1280, MATRIX, "about images of 1280 x 480 px, the goal's are 640 x 480 px"), (640, [0] * 9, "no focal length")],
)
def test_another_or_no_camera_is_refused(width, matrix, reason):
    with pytest.raises(StepError, match=reason):
        read_camera_info(SimpleNamespace(width=width, height=480, K=matrix), 640, 480)
