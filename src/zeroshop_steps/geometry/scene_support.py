"""Where the object stands: the point that all cameras look at and the plane below it, both from a registered whole scene."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.geometry.support_plane import estimate_up_from_roll
from zeroshop_steps.runtime.errors import StepError

TRIALS = 3000
NEAR_DISTANCES = 0.6  # points farther from the focus than this share of the cameras' distance say nothing about the support
THRESHOLD_DISTANCES = 0.004  # inliers lie this close to the plane
BELOW_DISTANCES = 0.3  # what is this near, horizontally, must not lie below the plane
MAX_TILT_DEG = 40.0  # between the plane's normal and the cameras' up
MIN_INLIERS = 40


@dataclass(frozen=True)
class SceneSupport:
    """The focus of the cameras and the plane that holds the object.

    Attributes:
        normal: (3,) unit normal towards the cameras, in the world frame of the registration.
        offset: the plane is normal . x = offset.
        focus: (3,) the point nearest to all optical axes.
        distance: median distance of the cameras from the focus; the scene's unit of length.
        inliers: sparse points on the plane.
    """

    normal: np.ndarray
    offset: float
    focus: np.ndarray
    distance: float
    inliers: int

    def heights(self, points: np.ndarray) -> np.ndarray:
        """(P,) heights of (P, 3) points above the plane."""
        return points @ self.normal - self.offset

    @property
    def foot(self) -> np.ndarray:
        """(3,) the point of the plane below the focus."""
        return self.focus - self.heights(self.focus[None])[0] * self.normal

    def axes(self) -> np.ndarray:
        """(2, 3) two unit vectors along the plane."""
        first = np.cross(self.normal, np.eye(3)[np.abs(self.normal).argmin()])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])


def fit_scene_support(model: SparseModel, views: list[View], seed: int = 0) -> SceneSupport:
    """Fit the plane among the sparse points around the focus.

    RANSAC (Fischler and Bolles 1981), then total least squares of the inliers. A candidate's score are the points on it less
    those below it near the focus: the lid of a box is a plane too, but its sides lie below it.

    Raises:
        StepError: no plane under what the cameras look at.
    """
    focus = find_focus(list(model.cameras))
    centres = np.array([camera.centre_in_world for camera in model.cameras])
    distance = float(np.median(np.linalg.norm(centres - focus, axis=1)))
    near = model.points[np.linalg.norm(model.points - focus, axis=1) < NEAR_DISTANCES * distance]
    fault = StepError(
        f"no support plane: {len(near)} points were found around what the cameras look at, and no plane among them holds "
        f"{MIN_INLIERS}; put the object on a flat surface with print (newspaper does), look at it from above, and film again"
    )
    if len(near) < MIN_INLIERS:
        raise fault
    up, _ = estimate_up_from_roll(views)
    rng = np.random.default_rng(seed)
    threshold = THRESHOLD_DISTANCES * distance
    best, best_score = None, 0.0
    for _ in range(TRIALS):
        a, b, c = near[rng.choice(len(near), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-6 * distance**2:
            continue
        normal = normal / length * (1.0 if normal @ up > 0 else -1.0)
        if normal @ up < np.cos(np.radians(MAX_TILT_DEG)) or (centres @ normal > a @ normal).mean() < 0.9:
            continue
        score = _score(near, focus, normal, float(a @ normal), threshold, distance)
        if score > best_score:
            best, best_score = (normal, float(a @ normal)), score
    if best is None:
        raise fault
    normal, offset = best
    for _ in range(10):
        chosen = near[np.abs(near @ normal - offset) < threshold]
        mean = chosen.mean(0)
        normal = np.linalg.svd(chosen - mean, full_matrices=False)[2][2]
        normal = normal * (1.0 if normal @ up > 0 else -1.0)
        offset = float(mean @ normal)
    inliers = int((np.abs(near @ normal - offset) < threshold).sum())
    if inliers < MIN_INLIERS:
        raise fault
    return SceneSupport(normal, offset, focus, distance, inliers)


def find_focus(cameras: list[Camera]) -> np.ndarray:
    """(3,) the point nearest to all optical axes, by least absolute distances, so that a few stray looks do not move it."""
    centres = np.array([camera.centre_in_world for camera in cameras])
    axes = np.array([camera.camera_from_world[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    weights = np.ones(len(cameras))
    for _ in range(20):
        system = (across * weights[:, None, None]).sum(0)
        focus = np.linalg.lstsq(system, (across @ centres[:, :, None] * weights[:, None, None]).sum(0)[:, 0], rcond=None)[0]
        miss = np.linalg.norm((across @ (focus - centres)[:, :, None])[..., 0], axis=1)
        weights = 1.0 / np.maximum(miss, 1e-3 * np.median(np.linalg.norm(centres - focus, axis=1)))
    if np.median(((focus - centres) * axes).sum(1)) <= 0:
        raise StepError("the cameras look away from each other, not at one point: move around the object and keep it in the middle")
    return focus


def _score(points: np.ndarray, focus: np.ndarray, normal: np.ndarray, offset: float, threshold: float, distance: float) -> float:
    heights = points @ normal - offset
    aside = points - focus
    aside = np.linalg.norm(aside - (aside @ normal)[:, None] * normal, axis=1)
    on = np.clip(1.0 - (heights / threshold) ** 2, 0.0, None).sum()
    return float(on - ((heights < -2 * threshold) & (aside < BELOW_DISTANCES * distance)).sum())
