"""Find the plane that the object stands on among the sparse points, or the up direction from the cameras' roll."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.registered_views import View

TRIALS = 2000
NEAR_DIAGONALS = 3.0  # background points farther than this many object diagonals say nothing about the support
THRESHOLD_DIAGONALS = 0.01  # inliers lie this close to the plane
TOUCH_DIAGONALS = 0.12  # the object's lowest part lies this close to its support
MAX_ROLL_ANGLE_DEG = 60.0  # between the plane's normal and the cameras' up, where that is well defined
MIN_INLIERS = 30
TILTED_SHARE = 0.1  # a plane that agrees with the cameras' up and holds less than this share of another's points is no plane


@dataclass(frozen=True)
class SupportPlane:
    """A plane, in the registration frame.

    Attributes:
        normal: (3,) unit normal towards the object.
        offset: the plane is normal . x = offset.
        inliers: number of sparse points on it.
        residual: root mean square distance of the inliers.
        normal_deviation_deg: standard deviation of the normal that these residuals imply.
    """

    normal: np.ndarray
    offset: float
    inliers: int
    residual: float
    normal_deviation_deg: float


def find_background_points(points: np.ndarray, views: list[View]) -> np.ndarray:
    """(P,) bool: sparse points that fall outside the masks, hence are not on the object.

    A point behind the object falls inside some masks, so a quarter of the views that hold it is enough.
    """
    outside, held = np.zeros(len(points), int), np.zeros(len(points), int)
    for view in views:
        mask = view.mask()
        pixels, depth = view.camera.project(points)
        x, y = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(np.int64).T
        inside_image = (depth > 0) & (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
        held += inside_image
        outside[inside_image] += ~mask[y[inside_image], x[inside_image]]
    return (outside >= 2) & (outside >= 0.25 * held)


def fit_support_plane(points: np.ndarray, vertices: np.ndarray, views: list[View], seed: int = 0) -> SupportPlane | None:
    """Fit the plane under the object; None where no plane is supported by the points.

    RANSAC (Fischler and Bolles 1981), then reweighted total least squares with Tukey's weights. A candidate must leave
    the object's vertices and the cameras on one side, and touch the object. One that agrees roughly with the cameras' up goes
    before others, so that walls do not; where it holds far fewer points than another, the cameras were tilted.

    Args:
        points: (P, 3) background points in the registration frame.
        vertices: (V, 3) the object's mesh.
        views: all registered views.
    """
    low, high = np.quantile(vertices, [0.01, 0.99], axis=0)
    centre, diagonal = (low + high) / 2, float(np.linalg.norm(vertices.std(0)) * np.sqrt(12.0))
    near = points[np.linalg.norm(points - centre, axis=1) < NEAR_DIAGONALS * diagonal]
    if len(near) < MIN_INLIERS:
        return None
    rng = np.random.default_rng(seed)
    vertices = vertices[rng.choice(len(vertices), min(2000, len(vertices)), replace=False)]
    cameras = np.array([view.camera.centre_in_world for view in views])
    up, certainty = estimate_up_from_roll(views)
    best: dict[bool, tuple[np.ndarray, float]] = {}
    best_score = {True: 0.0, False: 0.0}
    for _ in range(TRIALS):
        a, b, c = near[rng.choice(len(near), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-6 * diagonal**2:
            continue
        normal, offset = _towards(normal / length, a @ normal / length, centre)
        distance = np.abs(near @ normal - offset) / (THRESHOLD_DIAGONALS * diagonal)
        score = np.clip(1.0 - distance**2, 0.0, None).sum()
        upright = bool(certainty < 0.2 or normal @ up > np.cos(np.radians(MAX_ROLL_ANGLE_DEG)))
        if score > best_score[upright] and _supports(normal, offset, vertices, cameras, diagonal):
            best[upright], best_score[upright] = (normal, offset), score
    if not best:
        return None
    upright = best_score[True] > TILTED_SHARE * best_score[False]
    return _refined(*best[upright], near, centre, diagonal)


def estimate_up_from_roll(views: list[View]) -> tuple[np.ndarray, float]:
    """Up as the axis most orthogonal to all cameras' x axes, signed by their mean -y axis: photographers hold cameras level.

    Returns:
        up: (3,) unit vector in the registration frame.
        certainty: 0 to 1; near 0 the x axes leave the axis open (all cameras look one way, or are rolled).
    """
    rotations = np.array([view.camera.camera_from_world[:3, :3] for view in views])
    values, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", rotations[:, 0], rotations[:, 0]) / len(rotations))
    mean_up = -rotations[:, 1].mean(0)
    up = vectors[:, 0] * (1.0 if vectors[:, 0] @ mean_up >= 0 else -1.0)
    spread = float((values[1] - values[0]) / max(values[1] + values[0], 1e-12))
    if spread < 0.2:  # the x axes nearly agree: their own direction says nothing of up, the y axes do
        up = mean_up / max(np.linalg.norm(mean_up), 1e-12)
    return up, spread


def _towards(normal: np.ndarray, offset: float, point: np.ndarray) -> tuple[np.ndarray, float]:
    return (normal, float(offset)) if normal @ point >= offset else (-normal, float(-offset))


def _supports(normal: np.ndarray, offset: float, vertices: np.ndarray, cameras: np.ndarray, diagonal: float) -> bool:
    heights = vertices @ normal - offset
    if np.quantile(heights, 0.02) < -0.05 * diagonal or abs(np.quantile(heights, 0.01)) > TOUCH_DIAGONALS * diagonal:
        return False
    return bool((cameras @ normal > offset).mean() >= 0.8)


def _refined(normal: np.ndarray, offset: float, points: np.ndarray, centre: np.ndarray, diagonal: float) -> SupportPlane | None:
    threshold = THRESHOLD_DIAGONALS * diagonal
    for _ in range(20):
        residuals = points @ normal - offset
        chosen = np.abs(residuals) < threshold
        if chosen.sum() < MIN_INLIERS:
            return None
        weights = (1.0 - (residuals[chosen] / threshold) ** 2) ** 2
        mean = np.average(points[chosen], axis=0, weights=weights)
        scatter = np.einsum("n,ni,nj->ij", weights, points[chosen] - mean, points[chosen] - mean)
        values, vectors = np.linalg.eigh(scatter)
        normal, offset = _towards(vectors[:, 0], vectors[:, 0] @ mean, centre)
        # 4.5 robust deviations: the threshold follows the noise that the points show
        spread = 1.4826 * np.median(np.abs(points[chosen] @ normal - offset))
        threshold = float(np.clip(4.5 * spread, 0.1 * threshold, THRESHOLD_DIAGONALS * diagonal))
    residuals = points @ normal - offset
    chosen = np.abs(residuals) < threshold
    inliers, residual = int(chosen.sum()), float(np.sqrt(np.mean(residuals[chosen] ** 2)))
    if inliers < MIN_INLIERS:
        return None
    lever = np.sqrt(max(values[1], 1e-30) / weights.sum())  # the shorter extent of the points in the plane
    return SupportPlane(normal, offset, inliers, residual, float(np.degrees(residual / (np.sqrt(inliers) * lever))))
