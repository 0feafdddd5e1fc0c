"""The plane under a reconstructed object, fitted to sparse points; or else the up direction, from how the cameras were held."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.alignment.robust_estimates import robust_deviation
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.viewpoints import spread_over_sphere

# Lengths are shares of the object's diagonal.
# All were set by hand, and checked on all virtual objects and on tilted cameras (tests/finish/test_frame.py).
TRIALS = 3000  # of RANSAC; finds a plane with 15 % of the points at least once with 99.99 % probability
SMALLEST_TRIANGLE = 1e-6  # three points that span less than this (scale squared) lie on a line and give no plane
NEAR_DIAGONALS = 3.0  # points farther from the object belong to the room, not to its support
THRESHOLD_DIAGONALS = 0.01  # inliers lie this close to the plane
TOUCH_DIAGONALS = 0.12  # the object's lowest part lies this close to its support; more is another table
SUNK_DIAGONALS = 0.05  # the object may reach this far below a candidate: a raw mesh bulges at its foot
SUNK_SHARE, LOWEST_SHARE = 0.02, 0.01  # of the vertices; fewer are spikes, which do not count for the two limits above
CAMERAS_ABOVE_SHARE = 0.8  # of the cameras at least are above the support; some may be registered wrongly
MAX_ROLL_ANGLE_DEG = 60.0  # between the plane's normal and the cameras' up, where that is well defined
MIN_CERTAINTY = 0.2  # of the up from roll; below, the cameras' x axes nearly agree and leave it open
MOST_TILT = 0.03  # mean square of the sine of the angle by which photos that are held level lean to a side: 10 degrees
LEAST_TURN = 0.1  # mean square of their horizontal axes along the second direction, where the cameras go around the object
CANDIDATES_OF_UP = 4000  # directions, 3 degrees apart
LEAST_SQUARE, BETTER_SQUARE = 0.7, 0.1  # of 1, where all photos are rolled by quarter turns; and how much better than without such turns
LEAST_ROLLED = 8  # photos; of fewer, one of so many candidates explains any rolls by chance
LEAST_LEVEL = 0.15  # sine of the angle to straight down from which on a camera's roll is known
LEAST_HELD = 0.1  # of the photos are not sideways
QUARTER_TURNS = np.array([[[c, s, 0], [-s, c, 0], [0, 0, 1]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))], float)
UPRIGHT_RATIO = 1.5  # of the lengths of the means of the upright axes and the others, at least
MIN_INLIERS = 30  # fewer points are a plane by chance
FEW_INLIERS, LEVEL_DEG = 200, 10.0
"""A plane of fewer points than this that is not level is chance: points of other things on a plain table. Print has a thousand; photos that
are held by hand tell what is level to a few degrees."""
TILTED_SHARE = 0.1  # an upright plane with less than this share of another plane's score is chance: the cameras were tilted
OUTSIDE_VIEWS, OUTSIDE_SHARE = 2, 0.25  # a background point is outside the mask in so many views, and in this share of its views
VERTICES = 2000  # of the object are tested against each candidate: all of them would only take longer
REFINEMENT_ROUNDS = 20  # of least squares on the current inliers, which settle in fewer
TUKEY_DEVIATIONS = 4.5  # residuals beyond this many standard deviations count nothing (4.685 is 95 % efficient)
LEAST_SHRINKING = 0.1  # of the threshold from one round to the next, so that it does not collapse


@dataclass(frozen=True)
class Plane:
    """A plane: normal . x = offset.

    Attributes:
        normal: (3,) unit normal, in the registration's frame.
        offset: distance of the plane from the origin along the normal.
    """

    normal: np.ndarray
    offset: float

    def heights(self, points: np.ndarray) -> np.ndarray:
        """(P,) heights of (P, 3) points above the plane."""
        return points @ self.normal - self.offset


@dataclass(frozen=True)
class SupportPlane(Plane):
    """The plane under an object, its normal towards the object.

    Attributes:
        inliers: number of sparse points on it.
        residual: root mean square distance of the inliers.
        normal_deviation_deg: standard deviation of the normal that these residuals imply.
    """

    inliers: int
    residual: float
    normal_deviation_deg: float


def find_background_points(points: np.ndarray, views: list[View]) -> np.ndarray:
    """(P,) bool: which (P, 3) sparse points fall outside the masks, hence are not on the object.

    A point behind the object falls inside some masks, so it need not be outside in all views that show it.
    """
    shown, held = count_showing_masks(points, [view.camera for view in views], (view.mask() for view in views))
    outside = held - shown
    return (outside >= OUTSIDE_VIEWS) & (outside >= OUTSIDE_SHARE * held)


def count_showing_masks(points: np.ndarray, cameras: Iterable[Camera], masks: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(P,) in how many of the masks, (H, W) bool, (P, 3) points fall, and (P,) how many of the cameras have them in the image."""
    shown, held = np.zeros(len(points), int), np.zeros(len(points), int)
    for camera, mask in zip(cameras, masks, strict=True):
        rows, columns, _, inside_image = camera.find_pixels(points)
        held += inside_image
        shown[inside_image] += mask[rows[inside_image], columns[inside_image]]
    return shown, held


def fit_support_plane(points: np.ndarray, vertices: np.ndarray, views: list[View]) -> SupportPlane | None:
    """Fit the plane under the object; None where the points do not support any.

    RANSAC (Fischler and Bolles 1981), then reweighted total least squares with Tukey's weights. A candidate must have the
    object's vertices and the cameras on one side, and must touch the object. Candidates that roughly agree with the cameras'
    up are preferred, because others are mostly walls. Where they hold far fewer points than another candidate, the cameras
    were tilted.

    Args:
        points: (P, 3) background points in the registration's frame.
        vertices: (V, 3) of the object's mesh.
        views: all registered views.
    """
    low, high = np.quantile(vertices, [0.01, 0.99], axis=0)
    # The diagonal of the box, evenly filled, that has the vertices' standard deviations: stray parts hardly change it.
    centre, diagonal = (low + high) / 2, float(np.linalg.norm(vertices.std(0)) * np.sqrt(12.0))
    near = points[np.linalg.norm(points - centre, axis=1) < NEAR_DIAGONALS * diagonal]
    if len(near) < MIN_INLIERS:
        return None
    rng = np.random.default_rng(0)
    vertices = vertices[rng.choice(len(vertices), min(VERTICES, len(vertices)), replace=False)]
    cameras = np.array([view.camera.centre_in_world for view in views])
    up, certainty = estimate_up_from_roll(views)
    best: dict[bool, tuple[np.ndarray, float]] = {}
    best_score = {True: 0.0, False: 0.0}
    for candidate in zip(*sample_planes(near, diagonal, rng), strict=True):
        normal, offset = _orient(*candidate, centre)
        distance = np.abs(near @ normal - offset) / (THRESHOLD_DIAGONALS * diagonal)
        score = np.clip(1.0 - distance**2, 0.0, None).sum()
        upright = bool(certainty < MIN_CERTAINTY or normal @ up > np.cos(np.radians(MAX_ROLL_ANGLE_DEG)))
        if score > best_score[upright] and _supports(normal, offset, vertices, cameras, diagonal):
            best[upright], best_score[upright] = (normal, offset), score
    if not best:
        return None
    upright = best_score[True] > TILTED_SHARE * best_score[False]
    plane = _refine(*best[upright], near, centre, diagonal)
    # On a plain table, the refinement may climb from a few points of the table onto other things.
    if plane is None or not _supports(plane.normal, plane.offset, vertices, cameras, diagonal):
        return None
    level = certainty < MIN_CERTAINTY or plane.normal @ up > np.cos(np.radians(LEVEL_DEG))
    return plane if level or plane.inliers >= FEW_INLIERS else None


def sample_planes(points: np.ndarray, scale: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Candidates for RANSAC: (N, 3) unit normals and (N,) offsets of planes through three random points of (P, 3), but for those on a line.

    scale: size of the scene, in the points' unit.
    """
    a, b, c = points[rng.integers(len(points), size=(TRIALS, 3))].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    spans = lengths >= SMALLEST_TRIANGLE * scale**2
    normals = normals[spans] / lengths[spans, None]
    return normals, (a[spans] * normals).sum(1)


def estimate_up_from_roll(views: list[View]) -> tuple[np.ndarray, float]:
    """Estimate up from how the photos were held: the likeliest of `propose_ups`.

    Returns:
        up: (3,) unit vector in the registration's frame.
        certainty: 0 to 1; near 0 the x axes leave the axis open (all cameras look one way, or are rolled).
    """
    return propose_ups(views)[0]


def propose_ups(views: list[View]) -> list[tuple[np.ndarray, float]]:
    """Directions that may be up, the likeliest first, with their certainty: by how the photos were held.

    The axis most orthogonal to all cameras' x axes is one, on the side of their mean -y axis. Where photos are portrait and landscape
    mixed, the more frequent of the two counts: the others may be stored on their side, without a word of it in EXIF. All may be: then up is
    most orthogonal to their y axes, on the side from which they look. Or some of one size are: where another direction explains the rolls
    as quarter turns much better, they are turned back by these first, and that is the likeliest.
    """
    upright = np.array([view.camera.height_px > view.camera.width_px for view in views])
    usual = upright == (upright.mean() > 0.5)
    rotations = np.array([view.camera.camera_from_world[:3, :3] for view in views])
    up, certainty = _estimate_up(rotations[usual])
    if len(views) < LEAST_ROLLED:
        return [(up, certainty)]
    polar, azimuth = spread_over_sphere(CANDIDATES_OF_UP)
    candidates = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    square = _measure_squareness(rotations, candidates)
    as_it_is = float(_measure_squareness(rotations, up[None])[0])
    if square.max() <= max(LEAST_SQUARE, as_it_is + BETTER_SQUARE):
        return [(up, certainty)]
    axes = rotations @ candidates[square.argmax()]
    held = np.abs(axes[:, 1]) > np.abs(axes[:, 0])
    # Most photos that are not sideways are upright; where nearly all are sideways, they look down.
    if (axes[held, 1].sum() if held.mean() > LEAST_HELD else axes[:, 2].sum()) > 0:
        axes = -axes
    quarters = np.rint(np.arctan2(axes[:, 0], -axes[:, 1]) / (np.pi / 2)).astype(int) % 4
    return [_estimate_up(QUARTER_TURNS[quarters] @ rotations), (up, certainty)]


def _measure_squareness(rotations: np.ndarray, ups: np.ndarray) -> np.ndarray:
    """(U,) how well cameras with (N, 3, 3) rotations are rolled by quarter turns, if (U, 3) are up: 1 for all, 0 for any angles.

    Cameras that look straight down have no roll, and count as any angle.
    """
    across, down = ups @ rotations[:, 0].T, ups @ rotations[:, 1].T
    rolled = np.hypot(across, down) > LEAST_LEVEL
    found: np.ndarray = np.where(rolled, np.cos(4.0 * np.arctan2(across, down)), 0.0).mean(1)
    return found


def _estimate_up(rotations: np.ndarray) -> tuple[np.ndarray, float]:
    """Up and its certainty from the (N, 3, 3) rotations of cameras that are all rolled alike."""
    values, up, certainty = _find_most_orthogonal(rotations[:, 0])
    mean_up = -rotations[:, 1].mean(0)
    agreeing = [float(np.linalg.norm(rotations[:, row].mean(0))) for row in (0, 1)]  # upright axes agree, but others may on short arcs
    if certainty < MIN_CERTAINTY or values[0] > MOST_TILT or agreeing[0] > UPRIGHT_RATIO * agreeing[1]:
        turned_values, turned_up, turned_certainty = _find_most_orthogonal(rotations[:, 1])
        if turned_values[0] < min(MOST_TILT, values[0]) and turned_values[1] > LEAST_TURN and turned_certainty > MIN_CERTAINTY:
            return turned_up * (1.0 if turned_up @ rotations[:, 2].mean(0) <= 0 else -1.0), turned_certainty
    if certainty < MIN_CERTAINTY:  # the mean y axis is the better estimate
        return mean_up / max(np.linalg.norm(mean_up), 1e-12), certainty
    return up * (1.0 if up @ mean_up >= 0 else -1.0), certainty


def _find_most_orthogonal(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Ascending mean squares of (N, 3) unit axes along their principal directions, the first of these, and how surely it is the first."""
    values, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", axes, axes) / len(axes))
    return values, vectors[:, 0], float((values[1] - values[0]) / max(values[1] + values[0], 1e-12))


def _orient(normal: np.ndarray, offset: float, point: np.ndarray) -> tuple[np.ndarray, float]:
    """The plane with its normal towards a point."""
    return (normal, float(offset)) if normal @ point >= offset else (-normal, float(-offset))


def _supports(normal: np.ndarray, offset: float, vertices: np.ndarray, cameras: np.ndarray, diagonal: float) -> bool:
    """Whether a plane touches the object from below, and most cameras are above it."""
    heights = vertices @ normal - offset
    sunk = np.quantile(heights, SUNK_SHARE) < -SUNK_DIAGONALS * diagonal
    if sunk or abs(np.quantile(heights, LOWEST_SHARE)) > TOUCH_DIAGONALS * diagonal:
        return False
    return bool((cameras @ normal > offset).mean() >= CAMERAS_ABOVE_SHARE)


def _refine(normal: np.ndarray, offset: float, points: np.ndarray, centre: np.ndarray, diagonal: float) -> SupportPlane | None:
    threshold = THRESHOLD_DIAGONALS * diagonal
    for _ in range(REFINEMENT_ROUNDS):
        residuals = points @ normal - offset
        chosen = np.abs(residuals) < threshold
        if chosen.sum() < MIN_INLIERS:
            return None
        weights = (1.0 - (residuals[chosen] / threshold) ** 2) ** 2
        mean = np.average(points[chosen], axis=0, weights=weights)
        scatter = np.einsum("n,ni,nj->ij", weights, points[chosen] - mean, points[chosen] - mean)
        values, vectors = np.linalg.eigh(scatter)
        normal, offset = _orient(vectors[:, 0], float(vectors[:, 0] @ mean), centre)
        # The threshold follows the noise that the points show.
        spread = robust_deviation(points[chosen] @ normal - offset)
        threshold = float(np.clip(TUKEY_DEVIATIONS * spread, LEAST_SHRINKING * threshold, THRESHOLD_DIAGONALS * diagonal))
    residuals = points @ normal - offset
    chosen = np.abs(residuals) < threshold
    inliers, residual = int(chosen.sum()), float(np.sqrt(np.mean(residuals[chosen] ** 2)))
    if inliers < MIN_INLIERS:
        return None
    lever = np.sqrt(max(values[1], 1e-30) / weights.sum())  # the shorter extent of the points in the plane
    return SupportPlane(normal, offset, inliers, residual, float(np.degrees(residual / (np.sqrt(inliers) * lever))))
