"""Count the points that two neighbouring images should share and do not.

Sides that look alike can be laid onto each other: cameras that stood on opposite sides of the object then stand side by side, matches
and masks agree, and the reprojection error is small. But two images from nearly one direction must share many points. Those of
different sides share none, because what they look at is not the same.
"""

from dataclasses import dataclass

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.pinhole import take_cameras
from zeroshop_steps.geometry.cameras.ray_convergence import find_nearest_point
from zeroshop_steps.register.photometry.hull_views import NEAR_SCALE

NEAR_DEG = 30.0  # images are neighbours where their directions to the scene differ by at most so much
LEAST_EXPECTED = 40  # points that a pair should share to be judged


@dataclass(frozen=True)
class CovisiblePoints:
    """What neighbouring images share.

    Attributes:
        names: image names.
        expected: (N, N) symmetric number of points that one of two neighbours sees and that lie in the image of the other; 0 for others.
        shared: (N, N) symmetric number of those of them that the other sees, too.
    """

    names: tuple[str, ...]
    expected: np.ndarray
    shared: np.ndarray

    def find_noncovisible(self, least_share: float) -> tuple[int, np.ndarray]:
        """How many pairs are neighbours, and (N, N) bool: those that share less than this share of what they should."""
        judged = self.expected >= LEAST_EXPECTED
        return int(judged.sum()) // 2, judged & (self.shared < least_share * self.expected)


def count_covisible_points(model: pycolmap.Reconstruction) -> CovisiblePoints:
    """Project the points of every image into its neighbours, of all registered images of a model of pinhole cameras."""
    cameras, (names, near) = take_cameras(model), find_neighbours(model)
    images = {image.name: image for image in model.images.values()}
    seen = [np.unique([point.point3D_id for point in images[name].points2D if point.has_point3D()]) for name in names]
    places = {point_id: point.xyz for point_id, point in model.points3D.items()}
    expected, shared = np.zeros((2, len(names), len(names)), np.int64)
    for one, other in zip(*np.nonzero(near), strict=True):
        if one == other or not len(seen[one]):
            continue
        inside = cameras[other].find_pixels(np.array([places[int(p)] for p in seen[one]]))[3]
        expected[one, other] = inside.sum()
        shared[one, other] = np.isin(seen[one][inside], seen[other]).sum()
    return CovisiblePoints(tuple(names), expected + expected.T, shared + shared.T)


def find_neighbours(model: pycolmap.Reconstruction) -> tuple[list[str], np.ndarray]:
    """The names of the N registered images, in order, and (N, N) bool: which of them look at the scene from about the same place."""
    cameras = take_cameras(model)
    centres = np.array([camera.centre_in_world for camera in cameras])
    looks = centres - find_nearest_point(centres, np.array([camera.camera_from_world[2, :3] for camera in cameras]))
    distances = np.linalg.norm(looks, axis=1)
    looks /= distances[:, None]
    near = looks @ looks.T >= np.cos(np.radians(NEAR_DEG))
    near &= np.abs(np.log(distances[:, None] / distances[None])) <= np.log(NEAR_SCALE)
    return [camera.name for camera in cameras], near
