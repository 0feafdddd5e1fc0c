"""Find the cameras of an object without features, by its outlines alone.

Upright cameras are laid to each other one by one: at each azimuth and elevation of a grid, a view is shifted so that its tangents fit
those of the views before it, and the ways in which all rays through the rims pass through all masks are kept (a beam search).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.viewpoints import SAME_DIRECTION_DEG, make_intrinsics
from zeroshop_steps.register.scene.image_set import REFERENCE_PX, ImageSet
from zeroshop_steps.register.silhouettes.coarse_coherence import PRIOR_PX, measure_misses, try_places
from zeroshop_steps.register.silhouettes.coherence import choose_rim_pixels
from zeroshop_steps.register.silhouettes.epipolar_tangency import adjust_by_tangents, measure_prior
from zeroshop_steps.register.silhouettes.rays import make_outline_distance
from zeroshop_steps.register.silhouettes.view_poses import UNKNOWNS, Outlines, pose_views

SMALL_PX = 250  # longer side of the masks' copies
CORNERS, RIMS = 48, 24  # of an outline
GRID_DEG = 15
ABOVE_DEG, ANYWHERE_DEG = (5, 65), (-65, 65)  # elevations at which views are placed
BEAM = ((3, 240), (4, 240), (5, 120), (6, 40), (8, 12), (12, 6))  # ways that are kept, from so many views on
BRANCHES = 6  # places of a view that are followed in each way
PAIRS = BRANCHES * BEAM[0][1]  # ways of two views that are kept, more than there are above the object: nearly any two fit in most places
EVERY = 2  # of the rims' points that are looked at while views are laid
WIDE, USUAL_TOLERANCE, NARROW = 0.15, 0.05, 0.02
FOCAL_FROM = 6  # views that say the focal length
HOPELESS_PX, HOPELESS_FROM = 4.0, 8  # a search is given up where the best way misses by more with so many views: each further one adds
MISFIT_PX, MISFIT_RATIO, MISFIT_FROM = 2.0, 4.0, 4
"""A view is set aside where, with so many views, the best way misses by more than this and by so many times what it did without the view:
its mask is wrong. The mask of a mug among a drill's took it from 0.1 to 4 px; the views of right masks took it to 0.9 px at most."""


@dataclass
class PoseHypothesis:
    """One way in which some views may be placed."""

    views: np.ndarray
    log_focal: float
    cost: float = 0.0

    def make_poses(self, outlines: Outlines) -> np.ndarray:
        """(N, 4, 4) camera_from_world of all views."""
        rows = pose_views(self.views, self.log_focal, np.arange(len(self.views)), outlines)
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:12]
        return poses

    def take(self, numbers: np.ndarray) -> "PoseHypothesis":
        """These views alone."""
        return PoseHypothesis(self.views[numbers], self.log_focal, self.cost)


def take_outlines(outlines: Outlines, numbers: np.ndarray) -> Outlines:
    """The outlines of these views alone."""
    return outlines._replace(**{name: part[numbers] for name, part in outlines._asdict().items() if isinstance(part, np.ndarray)})


def prepare_outlines(masks: Sequence[np.ndarray], focal_px: np.ndarray) -> Outlines:
    """The outlines of N masks, (H, W) bool, whose principal points are the images' centres, with (N,) guesses of their focal lengths."""
    count = len(masks)
    corners, counts, middle = np.zeros((count, CORNERS, 2)), np.zeros(count, np.int64), np.zeros((count, 2))
    rims, sizes, distances, scales, principals = np.zeros((count, RIMS, 2)), [], [], np.zeros(count), np.zeros((count, 2))
    for number, mask in enumerate(masks):
        height, width = mask.shape
        centre = np.array([width, height]) / 2
        hull = (_find_hull(mask) - centre) / focal_px[number]
        corners[number, : len(hull)], counts[number] = hull, len(hull)
        middle[number] = (hull.min(0) + hull.max(0)) / 2
        sizes.append(np.linalg.norm(hull - middle[number], axis=1).max())
        chosen = choose_rim_pixels(mask, RIMS)
        rims[number] = (chosen[np.linspace(0, len(chosen) - 1, RIMS).round().astype(int)] - centre) / focal_px[number]
        shrink = SMALL_PX / max(width, height)
        small = cv2.resize(make_outline_distance(mask), None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        distances.append(small * REFERENCE_PX / max(width, height))
        scales[number] = focal_px[number] * shrink
        principals[number] = centre * [small.shape[1] / width, small.shape[0] / height]
    shape = np.max([distance.shape for distance in distances], axis=0)
    padded = [np.pad(d, [(0, shape[0] - d.shape[0]), (0, shape[1] - d.shape[1])], mode="edge") for d in distances]
    return Outlines(corners, counts, middle, float(np.median(sizes)), rims, np.array(padded, np.float32), scales, principals)


def search(
    outlines: Outlines, order: Sequence[int], elevations_deg: tuple[int, int], most_misfits: int = 0
) -> tuple[list[PoseHypothesis], np.ndarray]:
    """The likeliest ways in which the views may be placed, the best first, and the sorted numbers of the views that they place.

    Where no way is likely, the search ends before all views are placed: the cost says so.

    Args:
        outlines: of N views.
        order: in which they are placed.
        elevations_deg: the lowest and the highest at which they may lie.
        most_misfits: so many views at most are left out as they fit to the others nowhere.
    """
    places, pairs = make_places(elevations_deg, GRID_DEG), list[tuple[float, PoseHypothesis]]()
    for elevation in np.unique(places[:, 1]):
        first = PoseHypothesis(np.zeros((len(order), UNKNOWNS)), 0.0)
        first.views[order[0], 1] = elevation
        costs, laid = try_places(order[1], places, first.views, 0.0, np.array(order[:1]), outlines, EVERY, len(places))
        for cost, view in zip(costs, laid, strict=True):
            pairs.append((cost, PoseHypothesis(first.views.copy(), 0.0)))
            pairs[-1][1].views[order[1]] = view
    likely = np.sort(np.argsort([cost for cost, _ in pairs], kind="stable")[:PAIRS])
    ways = [pairs[number][1] for number in likely]
    placed, misfits = list(order[:2]), list[int]()
    for number in order[2:]:
        longer = _add_view(ways, np.array([*placed, number]), places, outlines)
        if len(misfits) < most_misfits and _is_misfit(longer, ways, len(placed) + 1):
            misfits.append(number)
            continue
        ways = longer
        placed.append(number)
        if len(placed) >= HOPELESS_FROM and ways[0].cost > HOPELESS_PX:
            break
    return ways, np.sort(placed)


def _is_misfit(longer: list[PoseHypothesis], ways: list[PoseHypothesis], count: int) -> bool:
    """Whether the view that `longer` have more than `ways` fits nowhere."""
    return count >= MISFIT_FROM and longer[0].cost > max(MISFIT_PX, MISFIT_RATIO * ways[0].cost)


def make_places(elevations_deg: tuple[int, int], grid_deg: int) -> np.ndarray:
    """(L, 2) azimuths and elevations all around the object, radians."""
    azimuths, elevations = np.arange(0, 360, grid_deg), np.arange(elevations_deg[0], elevations_deg[1] + 1, grid_deg)
    return np.radians([[azimuth, elevation] for elevation in elevations for azimuth in azimuths])


def _add_view(ways: list[PoseHypothesis], placed: np.ndarray, places: np.ndarray, outlines: Outlines) -> list[PoseHypothesis]:
    """All ways with one view more, the last of `placed`."""
    number, found = placed[-1], []
    for way in ways:
        costs, laid = try_places(number, places, way.views, way.log_focal, placed[:-1], outlines, EVERY, BRANCHES)
        for place in np.argsort(costs, kind="stable")[:BRANCHES]:
            views = way.views.copy()
            views[number] = laid[place]
            found.append(PoseHypothesis(views, way.log_focal, costs[place] + way.cost))
    width = next(width for least, width in reversed(BEAM) if len(placed) >= least)
    found = sorted(found, key=lambda way: way.cost)[: BRANCHES * width]
    every = np.ones(len(placed), bool)
    for way in found:
        for tolerance, rounds in ((WIDE, 4), (USUAL_TOLERANCE, 6)):
            free_focal = len(placed) >= FOCAL_FROM
            way.views, way.log_focal, _ = adjust_by_tangents(
                way.views, way.log_focal, placed, outlines, tolerance, rounds, free_focal, every
            )
        way.cost = measure_cost(way, placed, outlines)
    return keep_distinct(sorted(found, key=lambda way: way.cost), placed, width)


def measure_cost(way: PoseHypothesis, placed: np.ndarray, outlines: Outlines) -> float:
    """By how much the rays of these views miss, px per 1000 px in the mean, and how unusual their places are."""
    misses = measure_misses(way.views, way.log_focal, placed, outlines, EVERY)
    return float(misses.mean() + PRIOR_PX * np.mean([measure_prior(way.views[n], outlines.size) for n in placed]))


def keep_distinct(ways: list[PoseHypothesis], placed: np.ndarray, width: int) -> list[PoseHypothesis]:
    """The first `width` ways that differ from those before them."""
    kept: list[PoseHypothesis] = []
    looks: list[np.ndarray] = []
    for way in ways:
        look = compute_looks(way.views[placed], way.views[placed[0], 0])
        if all(np.degrees(np.arccos(np.clip((look * other).sum(1), -1, 1))).max() > SAME_DIRECTION_DEG for other in looks):
            kept.append(way)
            looks.append(look)
        if len(kept) == width:
            break
    return kept


def count_differing(one: PoseHypothesis, other: PoseHypothesis) -> int:
    """How many views look from other directions in two ways, turned onto each other as most views say."""
    turn = np.angle(np.exp(1j * (other.views[:, 0] - one.views[:, 0])))
    cosines = [(compute_looks(one.views, 0.0) * compute_looks(other.views, angle)).sum(1) for angle in turn]
    return int(min((np.degrees(np.arccos(np.clip(row, -1, 1))) > SAME_DIRECTION_DEG).sum() for row in cosines))


def compute_looks(views: np.ndarray, zero: float) -> np.ndarray:
    """(K, 3) directions from the object to views, turned by an azimuth."""
    azimuth, elevation = views[:, 0] - zero, views[:, 1]
    return np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)


def _find_hull(mask: np.ndarray) -> np.ndarray:
    """(V, 2) corners of the convex hull, in pixels."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull, tolerance_px = cv2.convexHull(np.concatenate(contours)), 0.4
    while True:
        corners: np.ndarray = cv2.approxPolyDP(hull, tolerance_px, True).reshape(-1, 2) + 0.5
        if len(corners) <= CORNERS:
            return corners
        tolerance_px *= 1.3


def make_cameras(way: PoseHypothesis, outlines: Outlines, image_set: ImageSet, focal_px: np.ndarray) -> list[Camera]:
    """Pinhole cameras of a way, in its frame."""
    return [
        Camera(name, *size_px, make_intrinsics(guess * np.exp(way.log_focal), *size_px), pose)
        for name, size_px, guess, pose in zip(image_set.names, image_set.sizes_px, focal_px, way.make_poses(outlines), strict=True)
    ]


def read_hypothesis(cameras: list[Camera], outlines: Outlines, focal_px: np.ndarray) -> PoseHypothesis:
    """The way that cameras stand in, whose frame is that of a way."""
    log_focal = float(np.log(cameras[0].intrinsics[0, 0] / focal_px[0]))
    views = np.zeros((len(cameras), UNKNOWNS))
    for view, camera, middle in zip(views, cameras, outlines.middle, strict=True):
        right, down, ahead = camera.camera_from_world[:3, :3]
        place = camera.camera_from_world[:3, 3]
        view[0], view[1] = np.arctan2(-ahead[1], -ahead[0]), np.arcsin(-ahead[2])
        level = np.array([-np.sin(view[0]), np.cos(view[0]), 0.0])
        view[2] = np.arctan2(-(level @ down), level @ right)
        view[3:5] = place[:2] / place[2] - middle * np.exp(-log_focal)
        view[5] = np.log(place[2])
    return PoseHypothesis(views, log_focal)
