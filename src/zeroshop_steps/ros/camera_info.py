"""Fields of sensor_msgs/CameraInfo, of ROS 1 and ROS 2."""

from typing import Any

import numpy as np

from zeroshop_steps.runtime.errors import StepError

FISHEYE = ("equidistant", "fisheye")  # models of distortion with the angle from the axis


def read_matrices(message: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(3, 3) K of the images as they are, (3, 3) of P, for rectified ones, and the coefficients of the distortion; P may be 0."""
    projection = np.array(_field(message, "p", np.zeros(12)), float).reshape(3, 4)[:, :3]
    return np.array(_field(message, "k"), float).reshape(3, 3), projection, np.array(_field(message, "d", ()), float)


def choose_matrix(message: Any, size_px: tuple[int, int], rectified: bool, what: str, remedy: str) -> np.ndarray:
    """(3, 3) K of images of (width, height): P where they are rectified and there is one.

    Args:
        what: the message, in words.
        remedy: where the camera was never calibrated.

    Raises:
        StepError: the message is about images of another size, or a part of them, or holds no such matrix.
    """
    if (message.width, message.height) != size_px:
        raise StepError(
            f"{what} is about images of {message.width} x {message.height} px, the images have {size_px[0]} x {size_px[1]} px; name the"
            " topic of the camera that takes these images"
        )
    part = getattr(message, "roi", None)
    cut = part is not None and (part.x_offset, part.y_offset, part.width or size_px[0], part.height or size_px[1]) != (0, 0, *size_px)
    if cut or max(getattr(message, "binning_x", 0), getattr(message, "binning_y", 0)) > 1:
        raise StepError(f"{what} says that images are cut out or binned (roi, binning), and K is not of them; record whole images")
    intrinsics, projection, _ = read_matrices(message)
    matrix = projection if rectified and projection[0, 0] > 0 else intrinsics
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise StepError(f"{what} has no focal length (K is 0, or no number): {remedy}")
    if not ((matrix[:2, 2] > 0).all() and (matrix[:2, 2] < size_px).all() and np.allclose(matrix[2], (0, 0, 1))):
        raise StepError(
            f"{what} has the matrix K = {matrix.ravel().tolist()}; expected fx, 0, cx, 0, fy, cy, 0, 0, 1 row by row, with cx and cy in the"
            f" image: {remedy}"
        )
    return matrix


def _field(message: Any, name: str, otherwise: Any = None) -> Any:
    """A field that has a capital in ROS 1 and a small letter in ROS 2."""
    return getattr(message, name.upper(), None) if hasattr(message, name.upper()) else getattr(message, name, otherwise)
