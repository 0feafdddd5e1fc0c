"""What the sparse points above the ground say of the object: a prior for its masks where the ground's colours tell only a part of it.

An object with print or grain has points all over, and those clearly above the support plane are neither ground nor shadow, whatever its
colours are. Where masks lack most of the dense cluster of them that the cameras look at, its silhouettes lead the masks.
"""

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.segment.mask_quality import measure_missed_share
from zeroshop_steps.segment.plain_ground import find_risen_points
from zeroshop_steps.segment.plane_search import find_thing
from zeroshop_steps.segment.point_silhouettes import LINK_DISTANCES, MOST_RADIUS, WIDTH_PX, draw_silhouette, measure_gap_px
from zeroshop_steps.segment.prior_maps import weigh_maps
from zeroshop_steps.segment.windows import cut_views, take_whole

# Set by hand on photos of a handbag on a wooden table (docs/results.md).
LEAST_POINTS = 100  # of the cluster; fewer do not outline an object
MISSED_SHARE = 0.5  # of its points: masks that lack more show another thing, or a part of this one
COVERED_SHARE = 0.15  # masks that lack less show all of it
TO_GROUND = np.linspace(0.0, 1.0, 9)  # heights at which the way from a point to the ground is drawn: the foot may have no print
BAND_SHARE = 0.1  # of the square root of the silhouette's area: so wide is the band around it that may be the object's plain rim
AROUND = 0.2  # of 1: what lies farther out; it may still be the object, such as a plain handle


class RisenPoints:
    """The dense cluster of sparse points above a support plane that the cameras look at."""

    def __init__(self, points: np.ndarray, support: SceneSupport) -> None:
        """Points (P, 3) of the cluster, in the frame of the plane."""
        self.points, self._support = points, support

    def are_missed_by(self, masks: list[np.ndarray], views: list[View]) -> bool:
        """Whether (H, W) bool masks of the views' images lack most of the points."""
        return measure_missed_share(self.points, [view.camera for view in views], masks) > MISSED_SHARE

    def are_covered_by(self, masks: list[np.ndarray], views: list[View]) -> bool:
        """Whether such masks show nearly all of the points."""
        return measure_missed_share(self.points, [view.camera for view in views], masks) < COVERED_SHARE

    def weigh(self, views: list[View]) -> list[np.ndarray]:
        """Log odds of the object, (h, w), in every view."""
        heights = self._support.heights(self.points)
        below = np.concatenate([self.points - share * heights[:, None] * self._support.normal for share in TO_GROUND])
        maps = [self._draw(below, camera) for camera in cut_views(views, take_whole(views), WIDTH_PX)[0]]
        return weigh_maps(maps, [view.camera for view in views])

    def _draw(self, below: np.ndarray, camera: Camera) -> np.ndarray:
        """(H, W) float32: 1 on the silhouette of the points, 1/2 below and around it, and less elsewhere."""
        gap_px = measure_gap_px(camera, self.points.mean(0), self._support.distance)
        silhouette, standing = (draw_silhouette(points, camera, gap_px) for points in (self.points, below))
        band_px = max(1, round(BAND_SHARE * float(np.sqrt(standing.sum()))))
        near = cv2.dilate(standing.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * band_px + 1,) * 2)) > 0
        return np.where(silhouette, 1.0, np.where(near, 0.5, AROUND)).astype(np.float32)


def find_cluster(model: SparseModel, support: SceneSupport) -> RisenPoints | None:
    """The cluster of the model's points above a plane; None where too few are there, or they are too far apart to be one thing."""
    found = find_thing(find_risen_points(model.points, support), support.focus, support.distance, LINK_DISTANCES)
    if found is None or len(found[0]) < LEAST_POINTS:
        return None
    points = found[0]
    radius = float(np.percentile(np.linalg.norm(points - points.mean(0), axis=1), 90))
    return RisenPoints(points, support) if radius < MOST_RADIUS * support.distance else None
