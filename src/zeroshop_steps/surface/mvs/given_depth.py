"""Depth images as measurements of the surface: in the registration's unit, by the sparse points that the photos see, and with their noise.

Lengths are in normalized units, as in depth_consistency.py, unless their names say otherwise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.alignment.robust_estimates import robust_deviation
from zeroshop_steps.geometry.cameras.object_crops import STRIDE_PX, ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.register.scene.depth_folder import OFF_DIAGONALS, DepthFolder
from zeroshop_steps.register.scene.image_set import MIN_IMAGES
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.surface.mvs.depth_maps import ray_slopes, unproject
from zeroshop_steps.surface.mvs.free_space import HullDistanceField
from zeroshop_steps.surface.mvs.noise_models import NOISE, NoiseModel
from zeroshop_steps.surface.rendering.training_views import TrainingView, make_grid_view

LEAST_POINTS = 10
"""Sparse points with measured depth that tell the scale in an image."""
WINDOW_PX = 3
"""Edge of the window, in pixels of the photo at least, whose median is a depth and whose range is the slope."""
RIM_PX = 3
"""Edge of the square by which masks are eroded: the outermost pixels are mixed with the background."""
HULL_MARGIN_VOXELS = 2.0
"""Depths farther outside the visual hull, and farther than three deviations, are wrong: all of the object lies inside."""
HULL_DIAGONAL = 2.0
"""Of the object, in normalized units: its sphere has radius 1."""
REFUSALS = "; the surface is measured by the photos alone"


@dataclass(frozen=True)
class GivenDepth:
    """Measured depth at the pixels of each view's stereo grid.

    Attributes:
        depths: for each view, (H, W) float32 depth along the optical axis, 0 where nothing was measured or a view has no image.
        deviations: (H, W) float32 their standard deviations.
        figures: for stereo.json.
    """

    depths: list[np.ndarray]
    deviations: list[np.ndarray]
    figures: dict[str, float]


def read_given_depth(
    folder: DepthFolder, kind: str, registered: Sequence[View], model: SparseModel, sphere: ObjectSphere, views: Sequence[TrainingView],
    hull: VisualHull,
) -> GivenDepth | None:  # fmt: skip
    """Read the depth images of registered views in the unit of the registration; None, and a warning, where too few tell the scale.

    Args:
        kind: of the camera, a key of `NOISE`.
        model: with the sparse points.
        views: the views in which stereo looks for seeds, in the order of `registered`.
        hull: that of the masks.

    Raises:
        StepError: an image is no depth image, has another unit, or is not aligned with its photo.
    """
    noise, grid = NOISE[kind], [make_grid_view(view) for view in views]
    measured: list[tuple[np.ndarray, np.ndarray] | None] = []
    ratios, residuals = {}, []
    for index, view in enumerate(registered):
        depth_mm = folder.read_mm(view)
        if depth_mm is None:
            measured.append(None)
            continue
        measured.append(_resample(noise, depth_mm, view.camera, grid[index].camera))
        if model.seen is not None:
            ratio, off = _compare_with_points(noise, depth_mm, view.camera, model.points[model.seen[index]])
            if len(ratio) >= LEAST_POINTS:
                ratios[view.camera.name] = float(np.median(ratio))
                residuals.append((ratio / np.median(ratio) - 1.0) / off)
    if len(ratios) < MIN_IMAGES:
        warn(f"{folder.folder}: {len(ratios)} depth images show enough sparse points to tell the scale, {MIN_IMAGES} are needed{REFUSALS}")
        return None
    # What is left says whether the camera is worse than its kind.
    factor = max(1.0, robust_deviation(np.concatenate(residuals)))
    scales = _measure_scales(ratios, registered)
    distance, depths, deviations, off_shares = HullDistanceField.from_hull(hull), [], [], {}
    for view, full, small, found in zip(registered, views, grid, measured, strict=True):
        depth, deviation = np.zeros((2, small.camera.height_px, small.camera.width_px), np.float32)
        if found is not None:
            inside = _erode(full)
            known = inside & (found[0] > 0)
            if known.any():
                folder.check_unit(view, float(np.median(found[0][known])))
            mm_per_unit = scales.get(view.pass_number, scales[0]) * sphere.radius
            depth, deviation = np.where(known, found[0] / mm_per_unit, 0.0), np.where(known, factor * found[1] / mm_per_unit, 0.0)
            depth, off_share = _drop_outside(small.camera, depth, deviation, distance)
            if off_share is not None and view.camera.name in ratios:
                off_shares[view.camera.name] = off_share
        depths.append(depth.astype(np.float32))
        deviations.append(np.where(depth > 0, deviation, 0.0).astype(np.float32))
    if len(off_shares) < MIN_IMAGES:
        warn(f"{folder.folder}: only {len(off_shares)} depth images have measured depth on the object, {MIN_IMAGES} are needed{REFUSALS}")
        return None
    _, spread, off_share = folder.agree({name: ratios[name] for name in off_shares}, off_shares)
    figures = {
        "images": len(off_shares),
        "mm_per_unit": scales.get(1, scales[0]),
        "spread": round(spread, 5),
        "off_share": round(off_share, 5),
        "noise_factor": round(factor, 3),
    }
    return GivenDepth(depths, deviations, figures)


def _measure_scales(ratios: Mapping[str, float], registered: Sequence[View]) -> dict[int, float]:
    """The mm per unit of each pass with enough images that tell it, by its number, and of all images, by 0.

    A pass has its own, since its cameras were put into the first one's unit by what both saw of the object, which depth measures better.
    """
    numbers = {view.camera.name: view.pass_number for view in registered}
    groups = {0: list(ratios.values())}
    groups |= {number: [ratio for name, ratio in ratios.items() if numbers[name] == number] for number in set(numbers.values())}
    return {number: float(np.median(group)) for number, group in groups.items() if number == 0 or len(group) >= MIN_IMAGES}


def _resample(noise: NoiseModel, depth_mm: np.ndarray, photo: Camera, grid: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) depth in mm, 0 where unknown, and its deviation, at the pixels of a grid on the same rays."""
    y, x = np.mgrid[: grid.height_px, : grid.width_px]
    slopes = ray_slopes(grid, y.ravel(), x.ravel())
    pixels = slopes * photo.intrinsics[[0, 1], [0, 1]] + photo.intrinsics[:2, 2]
    side = max(WINDOW_PX, int(photo.intrinsics[0, 0] / grid.intrinsics[0, 0]) // 2 * 2 + 1)
    depth, deviation = _look_up(noise, depth_mm, pixels, side)
    return depth.reshape(y.shape), deviation.reshape(y.shape)


def _look_up(noise: NoiseModel, depth_mm: np.ndarray, pixels: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """(P,) medians of the known depths in windows around (P, 2) pixels, 0 where half are unknown, and (P,) their deviations."""
    height, width = depth_mm.shape
    reach = side // 2
    steps = np.arange(-reach, reach + 1)
    x = np.clip(np.floor(pixels[:, 0]).astype(int)[:, None, None] + steps, 0, width - 1)
    y = np.clip(np.floor(pixels[:, 1]).astype(int)[:, None, None] + steps[:, None], 0, height - 1)
    values = depth_mm[y, x].reshape(len(pixels), len(steps) ** 2)
    values = np.sort(np.where(values > 0, values, np.inf), axis=1)
    count = np.isfinite(values).sum(axis=1)
    known = 2 * count > values.shape[1]
    rows, last = np.arange(len(pixels)), np.maximum(count - 1, 0)
    values[~known] = 0.0
    depth = values[rows, last // 2]
    slope = (values[rows, last] - values[:, 0]) / (side - 1)
    return depth, noise.deviation_mm(depth, slope, width)


def _compare_with_points(noise: NoiseModel, depth_mm: np.ndarray, camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K,) mm per unit at those of an image's sparse points where depth was measured, and (K,) their relative deviations."""
    pixels, z = camera.project(points)
    framed = (z > 0) & (pixels >= 0).all(1) & (pixels < [camera.width_px, camera.height_px]).all(1)
    depth, deviation = _look_up(noise, depth_mm, pixels[framed], WINDOW_PX)
    known = depth > 0
    return depth[known] / z[framed][known], deviation[known] / depth[known]


def _erode(view: TrainingView) -> np.ndarray:
    """(H, W) bool: the pixels of a view's grid that lie well inside its mask."""
    square = np.ones((RIM_PX, RIM_PX), np.uint8)
    return cv2.erode((view.mask.numpy() > 0.5).astype(np.uint8), square, borderValue=0)[::STRIDE_PX, ::STRIDE_PX] > 0


def _drop_outside(camera: Camera, depth: np.ndarray, deviation: np.ndarray, distance: HullDistanceField) -> tuple[np.ndarray, float | None]:
    """A depth map without what lies outside the hull, and the share that lies far outside, which shows something else."""
    y, x = np.nonzero(depth)
    if len(y) < LEAST_POINTS:
        return depth, None
    points, voxel = unproject(camera, depth, y, x), 2 * distance.half_extent / len(distance.distance_voxels)
    far = distance.farther_than(points, OFF_DIAGONALS * HULL_DIAGONAL / voxel)
    kept = ~distance.farther_than(points, HULL_MARGIN_VOXELS + 3.0 * deviation[y, x] / voxel)
    result = np.zeros_like(depth)
    result[y[kept], x[kept]] = depth[y[kept], x[kept]]
    return result, float(far.mean())
