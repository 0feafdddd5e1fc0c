"""Refine a way by where the points of each pass are seen in the images of the other: all cameras of a pass move as one.

Points that two passes pair lie within their own passes' errors of depth of each other, and images tell places across far better than
depths. So reprojection errors are minimized, not distances.
"""

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.optimize import least_squares

from zeroshop_steps.geometry.cameras.transforms import move_similarity, transform_points
from zeroshop_steps.join.object_matches import PointPairs
from zeroshop_steps.join.ways import Way
from zeroshop_steps.register.scene.image_set import REFERENCE_PX

NEAR_PX = 4.0  # a pair supports the refined way if the median of its errors is smaller


@dataclass(frozen=True)
class Observations:
    """Where points are seen.

    Attributes:
        point: (O,) index of the point.
        projection: (O, 3, 4) of the image, in px per 1000 px of it.
        pixels: (O, 2) where it is seen, in the same unit.
    """

    point: np.ndarray
    projection: np.ndarray
    pixels: np.ndarray

    def errors_px(self, points: np.ndarray) -> np.ndarray:
        """(O, 2) px per 1000 px, of (P, 3) points in the frame of the images."""
        homogeneous = np.concatenate([points[self.point], np.ones((len(self.point), 1))], axis=1)
        seen = np.einsum("oij,oj->oi", self.projection, homogeneous)
        return seen[:, :2] / seen[:, 2:] - self.pixels


def read_observations(model: pycolmap.Reconstruction, ids: np.ndarray) -> Observations:
    """The observations of points of a model of pinhole cameras, by their numbers."""
    point, projection, pixels = [], [], []
    for index, point_id in enumerate(ids):
        for element in model.points3D[int(point_id)].track.elements:
            image = model.images[element.image_id]
            camera = model.cameras[image.camera_id]
            unit = max(camera.width, camera.height) / REFERENCE_PX
            scale = np.diag([1 / unit, 1 / unit, 1.0])
            point.append(index)
            projection.append(scale @ camera.calibration_matrix() @ image.cam_from_world().matrix())
            pixels.append(image.points2D[element.point2D_idx].xy / unit)
    return Observations(np.array(point, int), np.array(projection).reshape(-1, 3, 4), np.array(pixels).reshape(-1, 2))


def refine(way: Way, pairs: PointPairs, target: pycolmap.Reconstruction, source: pycolmap.Reconstruction) -> Way:
    """The way after least squares of the reprojection errors of its pairs in both passes, and how many pairs support it then."""
    in_target, in_source = read_observations(target, pairs.target_ids), read_observations(source, pairs.source_ids)
    centre = pairs.target.mean(0)
    size = float(np.linalg.norm(pairs.target.std(0)))
    moved = way.target_from_source

    def errors_px(similarity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        forward = in_target.errors_px(transform_points(pairs.source, similarity))
        return forward, in_source.errors_px(transform_points(pairs.target, np.linalg.inv(similarity)))

    def measure_pairs_px(similarity: np.ndarray) -> np.ndarray:
        worst = [
            _median_of_points(np.linalg.norm(errors, axis=1), seen.point, len(pairs.target))
            for errors, seen in zip(errors_px(similarity), (in_target, in_source), strict=True)
        ]
        return np.maximum(*worst)

    # At first, pairs of the way are those whose points lie near each other: nearer than the tenth of the object that views may be off.
    chosen = np.linalg.norm(transform_points(pairs.source, moved) - pairs.target, axis=1) < 0.1 * size
    # The second round takes the pairs that support the first.
    for _ in range(2):
        start = moved

        def residuals(step: np.ndarray, start: np.ndarray = start, chosen: np.ndarray = chosen) -> np.ndarray:
            forward, back = errors_px(move_similarity(start, step, centre, size))
            return np.concatenate([forward[chosen[in_target.point]].ravel(), back[chosen[in_source.point]].ravel()])

        fit = least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=1.0, x_scale="jac")
        moved = move_similarity(start, fit.x, centre, size)
        near = measure_pairs_px(moved) < NEAR_PX
        if near.sum() < len(near[chosen]) / 4:
            break
        chosen = near
    return replace(way, target_from_source=moved, pairs=int((measure_pairs_px(moved) < NEAR_PX).sum()))


def _median_of_points(errors: np.ndarray, point: np.ndarray, count: int) -> np.ndarray:
    """(count,) the median error of each point."""
    order = np.argsort(point, kind="stable")
    parts = np.split(errors[order], np.searchsorted(point[order], np.arange(1, count)))
    return np.array([np.median(part) if len(part) else np.inf for part in parts])
