"""The camera matrix of goals, which have none: from the robot's topic, or given."""

import argparse
import threading
from typing import Any, Protocol

import numpy as np

from zeroshop_steps.runtime.errors import StepError

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


class GivenCamera:
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


def read_camera_info(message: Any, width: int, height: int) -> np.ndarray:
    """(3, 3) K of a camera's message, of ROS 1 or ROS 2. Raises StepError where it is of another image size, or was never calibrated."""
    if (message.width, message.height) != (width, height):
        raise StepError(
            f"the camera's message is about images of {message.width} x {message.height} px, the goal's are {width} x {height} px;"
            " name the topic of the camera that takes the goal's images"
        )
    matrix = getattr(message, "K", None)
    intrinsics = np.array(message.k if matrix is None else matrix, float).reshape(3, 3)
    if intrinsics[0, 0] <= 0:
        raise StepError("the camera's message has no focal length (K is 0): calibrate the camera, or start the servers with --intrinsics")
    return intrinsics
