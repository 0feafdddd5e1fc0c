"""Planes that the object may stand on: candidates, the likeliest first, and how a guessed one is moved to where the table is seen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.imaging.channels import take_largest
from zeroshop_steps.geometry.support.ground_plane import MIN_CERTAINTY, estimate_up_from_roll
from zeroshop_steps.geometry.support.scene_support import SceneSupport, find_scene_focus, measure_aside
from zeroshop_steps.segment.ground_picture import build_ground_picture
from zeroshop_steps.segment.mask_hull import Solution
from zeroshop_steps.segment.scene import MaskScene
from zeroshop_steps.segment.support_voxels import splat_voxels

# Lengths are shares of the cameras' distance from the focus.
LINK, LINKS, LEAST_POINTS = 0.03, 5, 20  # points so close to so many others are of one cluster, of at least so many
REACH, ASIDE = 0.5, 0.2  # points farther from the focus, and from the upright line through it, are not the object's
ABOVE = 0.1  # a second guess so far above the first is of a table, and not of an object's print above its foot
LOWEST_PERCENTILE = 3.0  # of the heights; lower points are wrong matches or mirror images
BELOW = 0.02  # the foot often has no print; a guess lies this far below the lowest points
STEPS = (np.arange(-5, 6) * 0.01, np.arange(-4, 5) * 0.002)  # moves of a guess to try, coarse and then fine
PICTURE = 0.3  # half the side of the square of the plane on which the views are compared
HIDDEN_PX = 3  # pixels this close to the object do not count: its mask is not exact
MOST_LEVELS = 25.0  # a larger disagreement counts no more: something hides the table there
MIN_CONTRAST = 1.04  # of the usual disagreement to the best plane's; below, the table shows nothing that tells its height


@dataclass(frozen=True)
class Candidate:
    """A plane that the object may stand on; None where its surroundings tell nothing. `fitted`: points gave it."""

    support: SceneSupport | None
    fitted: bool


def propose_supports(model: SparseModel, views: Sequence[View], planes: Sequence[SceneSupport]) -> Iterator[Candidate]:
    """The `planes` that sparse points lie on, the planes just below the object's own points, and none."""
    yield from (Candidate(plane, True) for plane in planes)
    yield from (Candidate(guess, False) for guess in guess_supports(model, list(views)))
    yield Candidate(None, False)


def guess_supports(model: SparseModel, views: list[View]) -> list[SceneSupport]:
    """Planes just below the sparse points of the object: of all that lie above or below what the cameras look at; and, where it is clearly
    higher, of the dense cluster that is nearest to that. On a small table in a room, other points lie on the floor.
    """
    up, certainty = estimate_up_from_roll(views)
    focus, distance = find_scene_focus(model)
    near = model.points[np.linalg.norm(model.points - focus, axis=1) < REACH * distance]
    own = near[measure_aside(near, focus, up) < ASIDE * distance]
    if certainty < MIN_CERTAINTY or len(own) < LEAST_POINTS:
        return []

    def measure_distance(cluster: np.ndarray) -> float:
        return float(np.linalg.norm(cluster - focus, axis=1).min() + 0.5 * np.linalg.norm(cluster.mean(0) - focus))

    cluster = min(find_clusters(near, LINK * distance), key=measure_distance, default=own)
    lowest, high = (float(np.percentile(points @ up, LOWEST_PERCENTILE)) for points in (own, cluster))
    offsets = [lowest] if high - lowest < ABOVE * distance else [lowest, high]
    return [SceneSupport(up, offset - BELOW * distance, focus, distance, 0) for offset in offsets]


def find_clusters(points: np.ndarray, link: float) -> list[np.ndarray]:
    """The dense clusters of (P, 3) points, (N, 3) each, in which points at most `link` apart belong together (Ester et al., KDD 1996).

    The object's own print is seen from near, so its points are dense.
    """
    if len(points) < LEAST_POINTS:
        return []
    pairs = cKDTree(points).query_pairs(link, output_type="ndarray")
    dense = np.bincount(pairs.ravel(), minlength=len(points)) >= LINKS
    linked = pairs[dense[pairs].all(1)]
    graph = sparse.coo_array((np.ones(len(linked), bool), (linked[:, 0], linked[:, 1])), shape=(len(points),) * 2)
    _, labels = csgraph.connected_components(graph, directed=False)
    return [points[labels == label] for label in np.flatnonzero(np.bincount(labels) >= LEAST_POINTS)]


def settle_support(support: SceneSupport, scene: MaskScene, solution: Solution) -> SceneSupport | None:
    """Move a guessed plane to where the views agree best on the table around the object; None where the table does not tell."""
    points = solution.grid.centres(np.argwhere(solution.occupied))
    # The mirror image on a glossy table does not lie on the table and is left out, too.
    mirrored = points - 2 * support.heights(points)[:, None] * support.normal
    window = np.ones((2 * HIDDEN_PX + 1,) * 2, np.uint8)
    hidden = [
        (cv2.dilate((mask > 0.5).astype(np.uint8), window) > 0) | splat_voxels(mirrored, solution.grid.side, camera)
        for mask, camera in zip(solution.masks, scene.cameras, strict=True)
    ]

    def measure(step: float) -> float:
        picture = build_ground_picture(_move(support, step), scene.cameras, scene.images, hidden, PICTURE)
        difference = np.minimum(take_largest(np.abs(picture.samples - picture.color)), MOST_LEVELS)
        seen = np.isfinite(difference) & picture.known
        return float(difference[seen].mean()) if seen.any() else MOST_LEVELS

    coarse = [measure(step) for step in STEPS[0]]
    best = int(np.argmin(coarse))
    if best in (0, len(coarse) - 1) or np.median(coarse) < MIN_CONTRAST * coarse[best]:
        return None
    steps = STEPS[0][best] + STEPS[1]
    return _move(support, float(steps[int(np.argmin([measure(step) for step in steps]))]))


def _move(support: SceneSupport, step: float) -> SceneSupport:
    return replace(support, offset=support.offset + step * support.distance)
