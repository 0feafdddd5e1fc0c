"""What the sparse points above the ground say of the object: a prior for its masks where the ground's colours tell only a part of it.

An object with print or grain has points all over, and those clearly above the support plane are neither ground nor shadow, whatever its
colours are. Where masks lack much of the dense cluster of them that the cameras look at, or contradict each other, its silhouettes lead the
masks. Around them and in their gaps, each photo is cut along its own colours.
"""

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.register.ground_contrast import cut_in_band
from zeroshop_steps.segment.mask_quality import measure_missed_share
from zeroshop_steps.segment.object_selection import REACH_DISTANCES
from zeroshop_steps.segment.plain_ground import find_risen_points
from zeroshop_steps.segment.plane_search import find_thing
from zeroshop_steps.segment.point_silhouettes import LINK_DISTANCES, WIDTH_PX, draw_silhouette, measure_gap_px
from zeroshop_steps.segment.prior_maps import weigh_maps
from zeroshop_steps.segment.windows import cut_views, take_whole

# Set by hand on photos of a handbag, two figures and a bust (docs/results.md).
LEAST_POINTS = 100  # of the cluster; fewer do not outline an object
LEAST_DEPTH = (
    0.12  # smallest extent over the largest: 0.03 to 0.07 where a guessed plane lay below the floor or table, 0.17 and more of things
)
MISSED_SHARE = 0.2  # of its points: masks that lack more show another thing, or a part of this one; right ones lack up to 0.1
COVERED_SHARE = 0.15  # masks that lack less show all of it
TO_GROUND = np.linspace(0.0, 1.0, 9)  # heights at which the way from a point to the ground is drawn: the foot may have no print
BAND_SHARE = 0.1  # of the square root of the silhouette's area: so wide is the band around it that may be the object's plain rim
SURE_SHARE = 0.01  # of it, too: what lies deeper inside the points' close silhouette is the object
CLOSE_GAPS = 1 / 3  # of the gaps that the silhouette closes: between points this close lies the object, between others there may be a gap
CUT_INSIDE, CUT_AROUND = (1.0, 0.55), (0.8, 0.3)
"""Of 1: what the photo's own colours give to the object, and what they do not, on the silhouette of the points and around it."""
AROUND = 0.2  # of 1: what lies farther out; it may still be the object, such as a plain handle
LEAST_COMMON = 10  # points of the object that two photos must share to be tied by it
TIED_SHARE = 0.9  # of the photos that must be tied; fewer are photos of two things, or of one that moved
STAYED_SHARE = 1 / 3  # of the photos that must be tied to each other over the whole capture: a handbag's front tied 10 of 17


class RisenPoints:
    """The dense cluster of sparse points above a support plane that the cameras look at."""

    def __init__(self, points: np.ndarray, support: SceneSupport) -> None:
        """Points (P, 3) of the cluster, in the frame of the plane."""
        self.points, self._support = points, support

    def are_missed_by(self, masks: list[np.ndarray], views: list[View]) -> bool:
        """Whether (H, W) bool masks of the views' images lack much of the points."""
        return self.measure_missed(masks, views) > MISSED_SHARE

    def are_covered_by(self, masks: list[np.ndarray], views: list[View]) -> bool:
        """Whether such masks show nearly all of the points."""
        return self.measure_missed(masks, views) < COVERED_SHARE

    def measure_missed(self, masks: list[np.ndarray], views: list[View]) -> float:
        """Share of the points that lie outside such masks, in the median view."""
        return measure_missed_share(self.points, [view.camera for view in views], masks)

    def tie(self, model: SparseModel) -> bool:
        """Whether these points of a model tie nearly all of its views to each other: they show one thing, which did not move."""
        tied = self._group_views(model)
        return bool(len(tied) and np.bincount(tied).max() >= TIED_SHARE * len(tied))

    def stay(self, model: SparseModel) -> bool:
        """Whether they tie early views to late ones, so that what they show stands where it stood, although not all views may see it.

        Views of the front and of the back of a thing may have no points in common. Of a thing that moved, views before and after have none.
        """
        tied = self._group_views(model)
        if not len(tied):
            return False
        largest = np.flatnonzero(tied == np.bincount(tied).argmax())
        return bool(np.ptp(largest) + 1 >= TIED_SHARE * len(tied) and len(largest) >= STAYED_SHARE * len(tied))

    def _group_views(self, model: SparseModel) -> np.ndarray:
        """For each view of a model, the group that common points tie it to; empty where it is not known which views see them."""
        if model.seen is None:
            return np.zeros(0, int)
        own = np.isin(_name_rows(model.points), _name_rows(self.points))
        sees = np.zeros((len(model.seen), len(own)), np.int32)
        for view, rows in enumerate(model.seen):
            sees[view, rows] = own[rows]
        return np.asarray(connected_components(csr_array(sees @ sees.T >= LEAST_COMMON), directed=False)[1])

    def weigh(self, views: list[View]) -> list[np.ndarray]:
        """Log odds of the object, (h, w), in every view."""
        heights = self._support.heights(self.points)
        below = np.concatenate([self.points - share * heights[:, None] * self._support.normal for share in TO_GROUND])
        cut = cut_views(views, take_whole(views), WIDTH_PX)
        maps = [self._draw(below, camera, image.astype(np.uint8)) for camera, image in zip(*cut, strict=True)]
        return weigh_maps(maps, [view.camera for view in views])

    def _draw(self, below: np.ndarray, camera: Camera, image: np.ndarray) -> np.ndarray:
        """(H, W) float32 by the silhouette of the points, what stands below and around it, and the colours of the (H, W, 3) photo."""
        gap_px = measure_gap_px(camera, self.points.mean(0), self._support.distance)
        silhouette, standing = (draw_silhouette(points, camera, gap_px) for points in (self.points, below))
        size_px = float(np.sqrt(standing.sum()))
        band = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * max(1, round(BAND_SHARE * size_px)) + 1,) * 2)
        near = cv2.dilate(standing.astype(np.uint8), band) > 0
        cut = cut_in_band(image, draw_silhouette(self.points, camera, CLOSE_GAPS * gap_px), near, SURE_SHARE * size_px)
        inside, around = (np.where(cut, *values) for values in (CUT_INSIDE, CUT_AROUND))
        return np.where(silhouette, inside, np.where(near, around, AROUND)).astype(np.float32)


def _name_rows(points: np.ndarray) -> np.ndarray:
    """(P,) names of (P, 3) positions, equal where these are."""
    return np.ascontiguousarray(points, np.float64).view(np.dtype((np.void, 24))).ravel()


def find_cluster(model: SparseModel, support: SceneSupport) -> RisenPoints | None:
    """The cluster of the model's points above a plane; None where too few are there, they are too far apart, or are themselves a plane."""
    found = find_thing(find_risen_points(model.points, support), support.focus, support.distance, LINK_DISTANCES)
    if found is None or len(found[0]) < LEAST_POINTS:
        return None
    points, away = found[0], found[0] - found[0].mean(0)
    extents = np.linalg.svd(away, compute_uv=False)
    if extents[2] < LEAST_DEPTH * extents[0]:
        return None
    return RisenPoints(points, support) if np.percentile(np.linalg.norm(away, axis=1), 90) < REACH_DISTANCES * support.distance else None
