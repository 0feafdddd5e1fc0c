"""The camera matrix of goals, which have none: from the robot's topic, or given."""

import argparse
import threading
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np

from zeroshop_steps.ros.camera_info import FISHEYE, choose_matrix, read_matrices
from zeroshop_steps.runtime.errors import StepError

MODELS: dict[str, tuple[int, ...]] = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), **dict.fromkeys(FISHEYE, (4,))}
"""Models of distortion of sensor_msgs/CameraInfo, and how many coefficients they have."""
UNSEEN_PX = 0.5  # a distortion that moves no pixel farther is none
WAIT_S = 5.0  # for the first message, when a goal comes before it


class CameraSource(Protocol):
    """Knows the camera of the goals' images."""

    def intrinsics_of(self, width: int, height: int) -> np.ndarray:
        """(3, 3) K for images of this size."""


class TopicCamera:
    """The latest sensor_msgs/CameraInfo of a topic; whoever subscribes calls `take`."""

    def __init__(self, topic: str) -> None:
        self.topic, self._latest, self._came = topic, None, threading.Event()

    def take(self, message: Any) -> None:
        """Take a message."""
        self._latest = message
        self._came.set()

    def intrinsics_of(self, width: int, height: int) -> np.ndarray:
        """(3, 3) K for images of this size. Raises StepError where the topic is silent or of another size."""
        if not self._came.wait(WAIT_S):
            raise StepError(f"no camera matrix has come on {self.topic}; check the topic, or start the servers with --intrinsics")
        return read_camera_info(self._latest, width, height)


class FixedCamera:
    """A camera matrix from the command line."""

    def __init__(self, fx: float, fy: float, cx: float, cy: float) -> None:
        self._intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])

    def intrinsics_of(self, width: int, height: int) -> np.ndarray:
        """(3, 3) K, of whatever size."""
        return self._intrinsics


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that say where the camera matrix comes from."""
    parser.add_argument("--camera-info-topic", help="topic of the camera's matrix")
    parser.add_argument("--intrinsics", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"), help="of the camera, in place of a topic")


@dataclass(frozen=True)
class GoalLens:
    """A camera as its message describes it.

    Attributes:
        intrinsics: (3, 3) K of the images once they are undistorted.
        maps: (height, width) float32 columns and rows of the pixels in the distorted image; None where there is no distortion.
    """

    intrinsics: np.ndarray
    maps: tuple[np.ndarray, np.ndarray] | None

    def undistort(self, image: np.ndarray) -> np.ndarray:
        """A photo as a camera without distortion takes it, or depth, whose values are not mixed."""
        if self.maps is None:
            return image
        mode = cv2.INTER_LINEAR if image.ndim == 3 else cv2.INTER_NEAREST
        return cv2.remap(image, *self.maps, mode, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def read_camera_info(message: Any, width: int, height: int) -> np.ndarray:
    """(3, 3) K of a camera's message, of ROS 1 or ROS 2.

    Raises:
        StepError: it is of another image size, was never calibrated, or has a distortion that is seen.
    """
    lens = read_lens(message, width, height, False)
    if lens.maps is not None:
        raise StepError(
            "the camera's message has a distortion, and goals need images without: send rectified images (image_proc), and start the"
            " servers with --intrinsics and the focal lengths and centre of the message's P"
        )
    return lens.intrinsics


def read_lens(message: Any, width: int, height: int, rectified: bool) -> GoalLens:
    """The camera of a message, of ROS 1 or ROS 2.

    Args:
        message: sensor_msgs/CameraInfo.
        width, height: of the images.
        rectified: whether the images have no distortion any more, though their message describes it; P is theirs.

    Raises:
        StepError: the message is of another image size, was never calibrated, or has an unknown model of distortion.
    """
    remedy = "calibrate the camera, or start the servers with --intrinsics"
    intrinsics = choose_matrix(message, (width, height), rectified, "the camera's message", remedy)
    coefficients = read_matrices(message)[2]
    if rectified or not coefficients.any():
        return GoalLens(intrinsics, None)
    model = getattr(message, "distortion_model", "") or "plumb_bob"
    if model not in MODELS or len(coefficients) not in MODELS[model] or not np.isfinite(coefficients).all():
        known = ", ".join(f"{name} ({' or '.join(map(str, counts))})" for name, counts in MODELS.items())
        raise StepError(
            f"the camera's message has the distortion {model!r} with {len(coefficients)} coefficients; expected finite numbers of {known}:"
            " record rectified images (image_proc)"
        )
    form = (intrinsics, (width, height), cv2.CV_32FC1)
    undistort = cv2.fisheye.initUndistortRectifyMap if model in FISHEYE else cv2.initUndistortRectifyMap
    columns, rows = undistort(intrinsics, coefficients, np.eye(3), *form)
    shift_px = np.hypot(columns - np.arange(width), rows - np.arange(height)[:, None]).max()
    return GoalLens(intrinsics, (columns, rows) if shift_px > UNSEEN_PX else None)
