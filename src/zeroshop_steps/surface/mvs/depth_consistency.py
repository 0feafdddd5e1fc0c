"""Seeds from stereo: of the depths at all pixels, those that other views' own depths confirm (Schönberger et al. 2016).

A patch that covers the rim of a hollow gives the plain surface behind it the depth of the rim, and all views from that side
make the same mistake. The views from the opposite side look through such a depth and contradict it (Merrell et al. 2007).

Lengths are in normalized units: the object lies within a sphere of radius 1.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.surface.mvs.depth_maps import find_gaps, unproject
from zeroshop_steps.surface.mvs.free_space import carve_free_space
from zeroshop_steps.surface.mvs.given_depth import GivenDepth
from zeroshop_steps.surface.mvs.joined_depth import CHECKED_VIEWS, CONTRADICTING_VIEWS_MIN, CONTRADICTION_GAP, join_depths
from zeroshop_steps.surface.mvs.patchmatch import estimate_depth_maps, select_neighbours
from zeroshop_steps.surface.mvs.seeds import Seeds
from zeroshop_steps.surface.rendering.training_views import TrainingView, make_grid_view

CONSISTENT_VIEWS_MIN = 2
"""A depth is confirmed when so many of them agree: as in COLMAP's multi-view stereo."""
SEED_COST_MAX = 0.3
"""Depths with a higher cost of stereo (0 to 2) are no seeds."""
CARVING_COST_MAX = 0.5
"""Depths with a higher cost do not carve the hull. The bound is looser, since a depth need not be exact to open a hollow."""
DEPTH_TOLERANCE = 0.01
"""Largest difference between the depths of two views that agree."""
SEED_SPACING = 0.015
"""Edge of the cubic cells in which seeds are averaged: about the size of a voxel of the hull, 2 / 128."""


def find_seeds(
    views: list[TrainingView], hull: VisualHull, seed: int, device: str = "cpu", given: GivenDepth | None = None
) -> tuple[Seeds, dict[str, int]]:
    """Find seeds within a visual hull, and carve the hull by what stereo has found; with it, figures of what given depth added.

    Args:
        views: training views in normalized coordinates; fine print needs full resolution.
        seed: of the random planes that stereo tries.
        device: where it searches them, as in `patchmatch.make_patchmatch`.
        given: depth that came with the images, as one more measurement.
    """
    depths, normals, costs = estimate_depth_maps(views, hull.occupied, hull.half_extent, seed, device=device)
    views = [make_grid_view(view) for view in views]
    cameras = [view.camera for view in views]
    carving = confirm_depths(views, _drop_costly(depths, costs, CARVING_COST_MAX))
    maps, weights, figures = confirm_depths(views, _drop_costly(depths, costs, SEED_COST_MAX)), None, {}
    if given is not None:
        joined = join_depths(cameras, maps, given)
        maps, weights, figures = joined.depths, joined.weights, joined.figures
        carving = [np.where(depth > 0, depth, other) for depth, other in zip(maps, carving, strict=True)]
    carved_hull = carve_free_space(hull, cameras, carving)
    points, colors, directions = [], [], []
    for view, depth, normal in zip(views, maps, normals, strict=True):
        y, x = np.nonzero(depth)
        points.append(unproject(view.camera, depth, y, x))
        colors.append(view.color.numpy()[:, y, x].T)
        directions.append(normal[y, x] @ view.camera.camera_from_world[:3, :3])
    seed_points, (seed_colors, seed_normals) = _average_in_cells(
        np.concatenate(points), [np.concatenate(colors), np.concatenate(directions)]
    )
    seed_normals /= np.maximum(np.linalg.norm(seed_normals, axis=1, keepdims=True), 1e-9)
    depth_maps = {view.camera.name: depth for view, depth in zip(views, maps, strict=True)}
    by_name = None if weights is None else {view.camera.name: weight for view, weight in zip(views, weights, strict=True)}
    return Seeds(seed_points, seed_colors, seed_normals, depth_maps, carved_hull, by_name), figures


def confirm_depths(views: list[TrainingView], depths: list[np.ndarray]) -> list[np.ndarray]:
    """Keep the depths that enough neighbouring views have found too and that no others look through; 0 elsewhere."""
    cameras = [view.camera for view in views]
    neighbours = select_neighbours(cameras, min(CHECKED_VIEWS, len(views) - 1))
    maps = []
    for camera, depth, checked in zip(cameras, depths, neighbours, strict=True):
        agreeing = [np.abs(gap) < DEPTH_TOLERANCE for gap in _depth_gaps(camera, depth, cameras, depths, checked)]
        maps.append(_keep_known(depth, np.sum(agreeing, axis=0) >= CONSISTENT_VIEWS_MIN))
    result = []
    for camera, depth in zip(cameras, maps, strict=True):
        contradicting = [gap > CONTRADICTION_GAP for gap in _depth_gaps(camera, depth, cameras, maps, range(len(views)))]
        result.append(_keep_known(depth, np.sum(contradicting, axis=0) < CONTRADICTING_VIEWS_MIN))
    return result


def _drop_costly(depths: list[np.ndarray], costs: list[np.ndarray], cost_max: float) -> list[np.ndarray]:
    """The depths whose cost is at most `cost_max`, 0 elsewhere."""
    return [np.where(cost <= cost_max, depth, np.float32(0)) for depth, cost in zip(depths, costs, strict=True)]


def _depth_gaps(
    camera: Camera, depth: np.ndarray, cameras: list[Camera], depths: list[np.ndarray], checked: Iterable[int]
) -> Iterator[np.ndarray]:
    """For each checked view, how far its own depth lies behind each of the (P,) known depths of a view; NaN where it has none."""
    y, x = np.nonzero(depth)
    world = unproject(camera, depth, y, x)
    for index in checked:
        yield find_gaps(cameras[index], depths[index], world)


def _keep_known(depth: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """A depth map with those of its (P,) known values that are `kept`, 0 elsewhere."""
    result = np.zeros_like(depth)
    y, x = np.nonzero(depth)
    result[y[kept], x[kept]] = depth[y[kept], x[kept]]
    return result


def _average_in_cells(points: np.ndarray, attributes: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Means of the points, and of their attributes, in cubic cells of edge SEED_SPACING."""
    if len(points) == 0:
        return points, attributes
    _, cell, count = np.unique(np.floor(points / SEED_SPACING).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(cell, column, len(count)) / count for column in values.T], 1)

    return mean(points), [mean(attribute) for attribute in attributes]
