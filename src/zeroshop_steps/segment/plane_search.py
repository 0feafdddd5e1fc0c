"""Find the support plane of a plain table, on which no sparse points lie.

Its normal is up, as the photos were held. A first guess of its place is just below the lowest points of the object. Then the plane is
moved along the normal until the views agree best on what they see around the object: the object's shadow and the table's grain lie on it.
"""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.channels import take_largest
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.scene_support import (
    THRESHOLD_DISTANCES,
    SceneSupport,
    find_scene_focus,
    fit_scene_support,
    measure_aside,
)
from zeroshop_steps.geometry.support_plane import FEW_INLIERS, MIN_CERTAINTY, count_showing_masks, estimate_up_from_roll
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.ground import sample_ground
from zeroshop_steps.segment.plain_ground import RISEN_DISTANCES
from zeroshop_steps.segment.voxel_carving import VoxelGrid, splat_voxels

# Lengths are shares of the cameras' distance from the focus. Set by hand on six rendered objects on four tables each (docs/results.md).
ASIDE_DISTANCES, REACH_DISTANCES = 0.2, 0.5  # points this close to the upright line through the focus, and to the focus, are the object's
MIN_POINTS = 20
LOWEST_PERCENTILE = 3.0  # of the heights; lower points are wrong matches or mirror images
BELOW_DISTANCES = 0.02  # the foot often has no print; the guess lies this far below the lowest points
COARSE_STEPS = np.arange(-5, 6) * 0.01  # moves of the guess to try first
FINE_STEPS = np.arange(-4, 5) * 0.002  # and then around the best of them
PICTURE_DISTANCES = 0.3  # half the side of the square of the plane on which the views are compared
HIDDEN_PX = 3  # pixels this close to the object do not count: its mask is not exact
MOST_LEVELS = 25.0  # a larger disagreement counts no more: something hides the table there
MIN_CONTRAST = 1.04  # of the usual disagreement to the best plane's; below, the table shows nothing that tells its height
HIGH_DISTANCES = 0.025
"""A fitted plane this far above the lowest points goes through things on the table, by chance."""
LINK_DISTANCES, LINKS = 0.03, 5  # points this close to each other, and to so many, are one thing
ABOVE_DISTANCES = 0.1  # a guess this far above the first is of a table, and not of an object's print above its foot
FACE_SHOWN, FACE_SHARE = 0.9, 0.5
"""A plane is a face of the object if at least this share of the masks shows at least this share of its points. Of five captures, masks
show 0.00 to 0.01 of the points on the ground so, and of a sixth 0.96 of those on the top of a plate, which is no ground."""
SETTLED_DISTANCES = 0.003  # a plane that moves less than this needs no new masks


def propose_supports(model: SparseModel, views: list[View], seed: int) -> Iterator[tuple[SceneSupport, bool]]:
    """The likeliest plane, and whether points gave it; after a guess, a higher one, for where no object is found on the first.

    A plane that points gave is never left: a higher one would cut off the part of the object below its print.

    Raises:
        StepError: as `guess_scene_support`.
    """
    first, fitted = find_scene_support(model, views, seed)
    yield first, fitted
    below = None if fitted else guess_below_thing(model, views)
    if below is not None and first.heights(below.foot[None])[0] > ABOVE_DISTANCES * below.distance:
        yield below, False


def find_scene_support(model: SparseModel, views: list[View], seed: int) -> tuple[SceneSupport, bool]:
    """The plane among the sparse points and True; where there is none, or it cannot hold the object, the guess and False.

    A plane that goes through the object, such as the top of a book, is left for one below it.

    Raises:
        StepError: as `guess_scene_support`.
    """
    try:
        fitted = fit_scene_support(model, views, seed)
    except StepError:
        return guess_scene_support(model, views), False
    try:
        guess = guess_scene_support(model, views)
    except StepError:
        return fitted, True
    lowest = guess.foot + BELOW_DISTANCES * guess.distance * guess.normal

    def may_hold(plane: SceneSupport) -> bool:
        return plane.inliers >= FEW_INLIERS and plane.heights(lowest[None])[0] >= -HIGH_DISTANCES * guess.distance

    if may_hold(fitted):
        return fitted, True
    below = _fit_below(model, views, fitted, seed, _lie_on(fitted, model.points))
    return (guess, False) if below is None or not may_hold(below) else (below, True)


def find_support_below(
    model: SparseModel, views: list[View], support: SceneSupport, seed: int, masks: list[np.ndarray]
) -> SceneSupport | None:
    """The plane below one that turns out to be a face of the object; None where there is none, or where it is no such face.

    The top of a plate with print may hold more points than the table around it. Then the masks, (H, W) bool of the views, show most of
    these points from all sides. The ground is hidden by the object in some views only.
    """
    shown, held = count_showing_masks(model.points, [view.camera for view in views], masks)
    face = _lie_on(support, model.points) & (shown > FACE_SHOWN * held)
    return _fit_below(model, views, support, seed, face) if face.sum() >= FACE_SHARE * support.inliers else None


def _lie_on(support: SceneSupport, points: np.ndarray) -> np.ndarray:
    """(P,) bool: the inliers of a plane among (P, 3) points."""
    return np.abs(support.heights(points)) < THRESHOLD_DISTANCES * support.distance


def _fit_below(model: SparseModel, views: list[View], support: SceneSupport, seed: int, without: np.ndarray) -> SceneSupport | None:
    """The plane among the sparse points without some, (P,) bool, if it lies below this one."""
    left = ~without
    rest = SparseModel(model.cameras, model.points[left], model.colors[left], model.track_lengths[left])
    try:
        below = fit_scene_support(rest, views, seed)
    except StepError:
        return None
    return below if support.heights(below.foot[None])[0] < -RISEN_DISTANCES * support.distance else None


def guess_scene_support(model: SparseModel, views: list[View]) -> SceneSupport:
    """The plane just below what the cameras look at.

    Raises:
        StepError: too few points are there, or the photos do not tell what is up.
    """
    focus, distance = find_scene_focus(model)
    up, certainty = estimate_up_from_roll(views)
    heights, aside = (model.points - focus) @ up, measure_aside(model.points, focus, up)
    own = heights[(aside < ASIDE_DISTANCES * distance) & (np.abs(heights) < REACH_DISTANCES * distance)]
    if len(own) < MIN_POINTS or certainty < MIN_CERTAINTY:
        raise StepError(
            f"no support plane: {len(own)} points were found on what the cameras look at, {MIN_POINTS} are needed, and the photos must be "
            "held level for the most part; put the object on a flat surface with print, such as a newspaper, and film it again from above"
        )
    lowest = float(np.percentile(own, LOWEST_PERCENTILE))
    return SceneSupport(up, float(focus @ up) + lowest - BELOW_DISTANCES * distance, focus, distance, 0)


def guess_below_thing(model: SparseModel, views: list[View]) -> SceneSupport | None:
    """The plane just below the dense cluster of sparse points that is nearest to what the cameras look at; None where there is none.

    On a small plain table in a furnished room, points around the object lie on the floor below the table, and on what stands behind it. The
    object's own print is seen from near, so its points are dense, and the table around them has none (density-based clusters: Ester et al.,
    KDD 1996).
    """
    focus, distance = find_scene_focus(model)
    up, certainty = estimate_up_from_roll(views)
    found = find_thing(model.points, focus, distance, LINK_DISTANCES) if certainty >= MIN_CERTAINTY else None
    if found is None:
        return None
    thing = found[0]
    middle = thing.mean(0)
    centres = np.array([camera.centre_in_world for camera in model.cameras])
    distance = float(np.median(np.linalg.norm(centres - middle, axis=1)))
    lowest = float(np.percentile(thing @ up, LOWEST_PERCENTILE))
    return SceneSupport(up, lowest - BELOW_DISTANCES * distance, middle, distance, 0)


def find_thing(points: np.ndarray, focus: np.ndarray, distance: float, link_distances: float) -> tuple[np.ndarray, int] | None:
    """The dense cluster of (P, 3) sparse points that is nearest to what the cameras look at, and how many points are around that.

    Args:
        points: all of them.
        focus, distance: what the cameras look at, (3,), and how far they are from it.
        link_distances: points so close to each other, as a share of the distance, are of one cluster.

    Returns:
        The cluster's points, (N, 3), and their number with those around; None where there is no cluster.
    """
    near = points[np.linalg.norm(points - focus, axis=1) < REACH_DISTANCES * distance]
    if len(near) < MIN_POINTS:
        return None
    pairs = cKDTree(near).query_pairs(link_distances * distance, output_type="ndarray")
    dense = np.bincount(pairs.ravel(), minlength=len(near)) >= LINKS
    linked = pairs[dense[pairs].all(1)]
    graph = sparse.coo_array((np.ones(len(linked), bool), (linked[:, 0], linked[:, 1])), shape=(len(near),) * 2)
    _, labels = csgraph.connected_components(graph, directed=False)
    clusters = [near[labels == label] for label in np.flatnonzero(np.bincount(labels) >= MIN_POINTS)]
    if not clusters:
        return None

    def measure_distance(cluster: np.ndarray) -> float:
        return float(np.linalg.norm(cluster - focus, axis=1).min() + 0.5 * np.linalg.norm(cluster.mean(0) - focus))

    return min(clusters, key=measure_distance), len(near)


def settle_support(
    support: SceneSupport, cameras: list[Camera], images: list[np.ndarray], masks: list[np.ndarray], grid: VoxelGrid, occupied: np.ndarray
) -> SceneSupport | None:
    """Move the plane to where the views agree best on the table around the object; None where the table does not tell.

    Args:
        support: the guess.
        cameras: of all views.
        images: (H, W, 3) float32 RGB of the cameras' sizes, of equal exposure.
        masks: (H, W) float32, above 1/2 on the object.
        grid: a block of voxels around the object.
        occupied: (X, Y, Z) bool: voxels of the object. Its mirror image on a glossy table does not lie on the table and is left out, too.
    """
    points = grid.centres(np.argwhere(occupied))
    mirrored = points - 2 * support.heights(points)[:, None] * support.normal
    window = np.ones((2 * HIDDEN_PX + 1,) * 2, np.uint8)
    hidden = [
        (cv2.dilate((mask > 0.5).astype(np.uint8), window) > 0) | splat_voxels(mirrored, grid.side, camera)
        for mask, camera in zip(masks, cameras, strict=True)
    ]

    def measure(step: float) -> float:
        ground, samples = sample_ground(_move(support, step), cameras, images, hidden, PICTURE_DISTANCES)
        difference = np.minimum(take_largest(np.abs(samples - ground.color)), MOST_LEVELS)
        seen = np.isfinite(difference) & ground.known
        return float(difference[seen].mean()) if seen.any() else MOST_LEVELS

    coarse = [measure(step) for step in COARSE_STEPS]
    best = int(np.argmin(coarse))
    if best in (0, len(coarse) - 1) or np.median(coarse) < MIN_CONTRAST * coarse[best]:
        return None
    steps = COARSE_STEPS[best] + FINE_STEPS
    return _move(support, float(steps[int(np.argmin([measure(step) for step in steps]))]))


def has_settled(before: SceneSupport, after: SceneSupport) -> bool:
    """Whether the second plane is so near to the first that masks by the first serve."""
    return abs(after.offset - before.offset) <= SETTLED_DISTANCES * before.distance


def _move(support: SceneSupport, step: float) -> SceneSupport:
    return replace(support, offset=support.offset + step * support.distance)
