"""Count the points that two neighbouring images should share and do not.

Sides that look alike can be laid onto each other: cameras that stood on opposite sides of the object then stand side by side, matches
and masks agree, and the reprojection error is small. But two images from nearly one direction must share many points. Those of
different sides share none, because what they look at is not the same.
"""

from dataclasses import dataclass

import numpy as np
import pycolmap

from zeroshop_steps.geometry.cameras.ray_convergence import find_nearest_point

NEAR_DEG, NEAR_SCALE = 30.0, 1.5
"""Images are neighbours where their directions to the scene differ by at most so much, and their distances by at most this factor."""
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
    """Project the points of every image into its neighbours, of all registered images."""
    images = _sort_images(model)
    poses = [image.cam_from_world().matrix() for image in images]
    near = find_neighbours(model)[1]
    seen = [np.unique([point.point3D_id for point in image.points2D if point.has_point3D()]) for image in images]
    places = {point_id: point.xyz for point_id, point in model.points3D.items()}
    expected, shared = np.zeros((2, len(images), len(images)), np.int64)
    for one, other in zip(*np.nonzero(near), strict=True):
        if one == other or not len(seen[one]):
            continue
        inside = _find_inside(model.cameras[images[other].camera_id], poses[other], np.array([places[int(p)] for p in seen[one]]))
        expected[one, other] = inside.sum()
        shared[one, other] = np.isin(seen[one][inside], seen[other]).sum()
    return CovisiblePoints(tuple(image.name for image in images), expected + expected.T, shared + shared.T)


def find_neighbours(model: pycolmap.Reconstruction) -> tuple[list[str], np.ndarray]:
    """The names of the N registered images, in order, and (N, N) bool: which of them look at the scene from about the same place."""
    images = _sort_images(model)
    poses = [image.cam_from_world().matrix() for image in images]
    centres = np.array([-pose[:, :3].T @ pose[:, 3] for pose in poses])
    looks = centres - find_nearest_point(centres, np.array([pose[2, :3] for pose in poses]))
    distances = np.linalg.norm(looks, axis=1)
    looks /= distances[:, None]
    near = looks @ looks.T >= np.cos(np.radians(NEAR_DEG))
    near &= np.abs(np.log(distances[:, None] / distances[None])) <= np.log(NEAR_SCALE)
    return [image.name for image in images], near


def _sort_images(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    return sorted((model.images[image_id] for image_id in model.reg_image_ids()), key=lambda image: image.name)


def _find_inside(camera: pycolmap.Camera, camera_from_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P,) bool: points in front of a camera and in its image."""
    local = points @ camera_from_world[:, :3].T + camera_from_world[:, 3]
    inside = local[:, 2] > 0
    pixels = np.full((len(points), 2), -1.0)
    if inside.any():
        pixels[inside] = camera.img_from_cam(local[inside])
    return inside & (pixels >= 0).all(1) & (pixels < [camera.width, camera.height]).all(1)
