"""What the object stands on in a whole scene, before it has a mask: the point that all cameras look at and the plane below it."""

from dataclasses import dataclass, replace

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel
from zeroshop_steps.geometry.cameras.ray_convergence import find_nearest_point
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.support.ground_plane import (
    CAMERAS_ABOVE_SHARE,
    FEW_INLIERS,
    MIN_INLIERS,
    REFINEMENT_ROUNDS,
    Plane,
    propose_ups,
    sample_planes,
)
from zeroshop_steps.runtime.errors import StepError

# Lengths are shares of the cameras' median distance from the focus.
# All were set by hand, and checked on the kitchen photos, the DTU skull and virtual scenes.
NEAR_DISTANCES = 0.6  # points farther from the focus belong to the room, not to the support
THRESHOLD_DISTANCES = 0.004  # inliers lie this close to the plane: 2 mm for cameras at 0.5 m
BELOW_DISTANCES = 0.3  # within this horizontal distance from the focus, nothing may lie below the support
BELOW_THRESHOLDS = 2.0  # a point this many thresholds below a candidate speaks against it
MAX_TILT_DEG = 40.0  # between the plane's normal and the cameras' up, which is only roughly known; steeper planes are walls
OBJECT_DISTANCES = 0.22  # the radius of an object that fills most of the photos' height
AROUND_SHARE = 0.15  # of the inliers lie beyond it; a plane without them is a flat side of the object itself
RISEN = 0.012  # a plane lies below another one by at least this
AT_ONCE = 250  # candidates, for memory


@dataclass(frozen=True)
class SceneSupport(Plane):
    """The plane that holds the object, its normal towards the cameras, and the point that the cameras look at.

    Attributes:
        focus: (3,) the point nearest to all optical axes.
        distance: median distance of the cameras from the focus; the scene's unit of length.
        inliers: sparse points on the plane.
    """

    focus: np.ndarray
    distance: float
    inliers: int

    @property
    def foot(self) -> np.ndarray:
        """(3,) the point of the plane below the focus."""
        return self.focus - self.heights(self.focus[None])[0] * self.normal

    def axes(self) -> np.ndarray:
        """(2, 3) two unit vectors along the plane, orthogonal to each other."""
        return find_plane_axes(self.normal)


def find_plane_axes(normal: np.ndarray) -> np.ndarray:
    """(2, 3) two unit vectors along the plane with this (3,) unit normal, orthogonal to each other."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def fit_scene_support(model: SparseModel, views: list[View], seed: int = 0) -> SceneSupport:
    """Fit the plane to the sparse points around the focus.

    RANSAC (Fischler and Bolles 1981), then total least squares of the inliers. A candidate scores the points on it minus the
    points below it near the focus: the lid of a box is a plane too, but the box's sides lie below it.

    Raises:
        StepError: there is no plane below the point that the cameras look at.
    """
    focus, distance = find_scene_focus(model)
    centres = np.array([camera.centre_in_world for camera in model.cameras])
    near = model.points[np.linalg.norm(model.points - focus, axis=1) < NEAR_DISTANCES * distance]
    fault = StepError(
        f"no support plane: {len(near)} points were found around what the cameras look at, and no plane among them holds "
        f"{MIN_INLIERS}; put the object on a flat surface with print, such as a newspaper, and film it again from above"
    )
    if len(near) < MIN_INLIERS:
        raise fault
    threshold = THRESHOLD_DISTANCES * distance
    found = [_sample_upright_planes(near, up, centres, distance, np.random.default_rng(seed)) for up, _ in propose_ups(views)]
    normals, offsets = (np.concatenate(parts) for parts in zip(*found, strict=True))
    parts = [slice(start, start + AT_ONCE) for start in range(0, len(normals), AT_ONCE)]
    scores = np.concatenate([[0.0], *(_score(near, focus, normals[part], offsets[part], threshold, distance) for part in parts)])
    if not scores.argmax():
        raise fault
    normal, offset = normals[scores.argmax() - 1], float(offsets[scores.argmax() - 1])
    for _ in range(REFINEMENT_ROUNDS):
        chosen = near[np.abs(near @ normal - offset) < threshold]
        mean = chosen.mean(0)
        before, normal = normal, np.linalg.svd(chosen - mean, full_matrices=False)[2][2]
        normal = normal * (1.0 if normal @ before > 0 else -1.0)
        offset = float(mean @ normal)
    on_plane = near[np.abs(near @ normal - offset) < threshold]
    aside = measure_aside(on_plane, focus, normal)
    if len(on_plane) < MIN_INLIERS or (aside > OBJECT_DISTANCES * distance).mean() < AROUND_SHARE:
        raise fault
    return SceneSupport(normal, offset, focus, distance, len(on_plane))


def fit_level_planes(model: SparseModel, views: list[View], seed: int = 0) -> list[SceneSupport]:
    """The plane that most sparse points lie on, and the next one if it lies below that; none where `fit_scene_support` finds none."""
    planes: list[SceneSupport] = []
    try:
        planes.append(first := fit_scene_support(model, views, seed))
        rest = np.abs(first.heights(model.points)) >= THRESHOLD_DISTANCES * first.distance
        below = fit_scene_support(replace(model, points=model.points[rest], seen=None), views, seed)
    except StepError:
        return planes
    if below.inliers >= FEW_INLIERS and first.heights(below.foot[None])[0] < -RISEN * first.distance:
        planes.append(below)
    return planes


def find_focus(cameras: list[Camera]) -> np.ndarray:
    """(3,) the point nearest to all optical axes.

    Raises:
        StepError: it lies behind half of the cameras.
    """
    centres = np.array([camera.centre_in_world for camera in cameras])
    axes = np.array([camera.camera_from_world[2, :3] for camera in cameras])
    focus = find_nearest_point(centres, axes)
    if np.median(((focus - centres) * axes).sum(1)) <= 0:
        raise StepError("the cameras look away from each other, not at one point: move around the object and keep it in the middle")
    return focus


def find_scene_focus(model: SparseModel) -> tuple[np.ndarray, float]:
    """The focus, (3,), and the cameras' median distance from it. Raises StepError as `find_focus` does."""
    focus = find_focus(list(model.cameras))
    centres = np.array([camera.centre_in_world for camera in model.cameras])
    return focus, float(np.median(np.linalg.norm(centres - focus, axis=1)))


def measure_aside(points: np.ndarray, focus: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(P,) distances of (P, 3) points from the line through the focus along a unit normal."""
    offsets = points - focus
    return np.linalg.norm(offsets - (offsets @ normal)[:, None] * normal, axis=1)


def _sample_upright_planes(
    points: np.ndarray, up: np.ndarray, centres: np.ndarray, scale: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Planes through three points, normals upwards, that are about level where (3,) is up, with most (N, 3) camera centres above them."""
    normals, offsets = sample_planes(points, scale, rng)
    signs = np.where(normals @ up > 0, 1.0, -1.0)
    normals, offsets = normals * signs[:, None], offsets * signs
    upright = (normals @ up >= np.cos(np.radians(MAX_TILT_DEG))) & ((centres @ normals.T > offsets).mean(0) >= CAMERAS_ABOVE_SHARE)
    return normals[upright], offsets[upright]


def _score(
    points: np.ndarray, focus: np.ndarray, normals: np.ndarray, offsets: np.ndarray, threshold: float, distance: float
) -> np.ndarray:
    """(N,) how well planes hold (P, 3) points: inliers, which count less towards the threshold, minus points below it near the focus."""
    heights = points @ normals.T - offsets
    away = points - focus
    aside = (away**2).sum(1)[:, None] - (away @ normals.T) ** 2
    on = np.clip(1.0 - (heights / threshold) ** 2, 0.0, None).sum(0)
    return np.asarray(on - ((heights < -BELOW_THRESHOLDS * threshold) & (aside < (BELOW_DISTANCES * distance) ** 2)).sum(0))
