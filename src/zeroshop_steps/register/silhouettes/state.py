"""What is adjusted where an object's outlines hold its cameras: the cameras, and the points of its tracks."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Tracks:
    """Points that several views see.

    Attributes:
        view, point: (O,) numbers of the view and of the point of each observation.
        pixels: (O, 2) where it lies, in pixels of the pinhole cameras.
    """

    view: np.ndarray
    point: np.ndarray
    pixels: np.ndarray

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.point.max()) + 1 if len(self.point) else 0


class TrackKind(Enum):
    """How exact the observations of tracks are."""

    MATCHED = "found in each image by itself"
    GUIDED = "found where the visual hull leads to (guided_matching)"
    ALIGNED = "aligned by the pictures (keypoint refinement)"


NO_TRACKS = Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
"""Where cameras are adjusted by outlines alone."""


@dataclass(frozen=True)
class State:
    """What is adjusted, in a world whose origin is the object's centre and whose unit is its radius.

    Attributes:
        rotation, translation: (N, 3, 3) and (N, 3) camera_from_world.
        log_focal: logarithm of the factor of all focal lengths.
        points: (P, 3) of the tracks.
    """

    rotation: np.ndarray
    translation: np.ndarray
    log_focal: float
    points: np.ndarray

    def moved(self, step: np.ndarray, points_step: np.ndarray) -> "State":
        """The state after (6 N + 1,) a step of the cameras, each turned about the object, and (P, 3) of the points."""
        by_view = step[:-1].reshape(-1, 6)
        turned = self.rotation @ Rotation.from_rotvec(by_view[:, :3]).as_matrix()
        return State(turned, self.translation + by_view[:, 3:], self.log_focal + step[-1], self.points + points_step)
