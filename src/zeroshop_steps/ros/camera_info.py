"""Fields of sensor_msgs/CameraInfo, of ROS 1 and ROS 2."""

from typing import Any

import numpy as np

FISHEYE = ("equidistant", "fisheye")  # models of distortion with the angle from the axis


def read_matrices(message: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(3, 3) K of the images as they are, (3, 3) of P, for rectified ones, and the coefficients of the distortion; P may be 0."""
    projection = np.array(_field(message, "p", np.zeros(12)), float).reshape(3, 4)[:, :3]
    return np.array(_field(message, "k"), float).reshape(3, 3), projection, np.array(_field(message, "d", ()), float)


def _field(message: Any, name: str, otherwise: Any = None) -> Any:
    """A field that has a capital in ROS 1 and a small letter in ROS 2."""
    return getattr(message, name.upper(), None) if hasattr(message, name.upper()) else getattr(message, name, otherwise)
