"""Seeds from stereo: a depth for every pixel, of which those that other views' own depths confirm stay (Schönberger et al. 2016).

A patch that holds the rim of a hollow gives the plain surface behind it the rim's depth, in all views from that side alike; the
views across look through such a depth, and contradict it (Merrell et al. 2007).
"""

from collections.abc import Iterable, Iterator

import numpy as np

from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.visual_hull import VisualHull
from zeroshop_steps.surface.free_space import carve_free_space
from zeroshop_steps.surface.patchmatch import estimate_depth_maps, select_neighbours
from zeroshop_steps.surface.seeds import Seeds
from zeroshop_steps.surface.training_views import TrainingView, make_grid_view

WITNESSES = 8
"""Neighbouring views that are asked."""
CONFIRMATIONS = 2
COST_MAX = 0.3
"""Depths of a higher stereo cost are no seeds."""
CARVING_COST_MAX = 0.5
"""Depths of a higher stereo cost do not carve; a depth need not be exact to show that a lid is none."""
TOLERANCE = 0.01
"""Largest difference, in normalized units, between depths of two views that confirm each other."""
SEEN_THROUGH_BY = 2
"""A depth is false where so many views have found surface behind it."""
SEEN_THROUGH = 0.03
"""How far behind, in normalized units: three tolerances."""
SPACING = 0.015
"""Edge, in normalized units, of the cells in which seeds are averaged."""


def find_seeds(views: list[TrainingView], hull: VisualHull, seed: int) -> Seeds:
    """Seeds within a visual hull, with the hull carved by what stereo has found.

    Args:
        views: training views in normalized coordinates; fine print wants full resolution.
    """
    depths, normals, costs = estimate_depth_maps(views, hull.occupied, hull.half_extent, seed)
    views = [make_grid_view(view) for view in views]
    cameras = [view.camera for view in views]
    volume = carve_free_space(hull, cameras, confirm_depths(views, _below(CARVING_COST_MAX, depths, costs)))
    maps = confirm_depths(views, _below(COST_MAX, depths, costs))
    points, colors, directions = [], [], []
    for view, depth, normal in zip(views, maps, normals, strict=True):
        y, x = np.nonzero(depth)
        points.append(_world_points(view, depth, y, x))
        colors.append(view.color.numpy()[:, y, x].T)
        directions.append(normal[y, x] @ view.camera.camera_from_world[:3, :3])
    positions, (colors, normals) = _averaged(np.concatenate(points), [np.concatenate(colors), np.concatenate(directions)])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return Seeds(positions, colors, normals, {view.camera.name: depth for view, depth in zip(views, maps, strict=True)}, volume)


def _below(cost_max: float, depths: list[np.ndarray], costs: list[np.ndarray]) -> list[np.ndarray]:
    return [np.where(cost <= cost_max, depth, np.float32(0)) for depth, cost in zip(depths, costs, strict=True)]


def _world_points(view: TrainingView, depth: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    k, pose = view.camera.intrinsics, view.camera.camera_from_world
    rays = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1], np.ones(len(x))], 1)
    return (rays * depth[y, x][:, None] - pose[:3, 3]) @ pose[:3, :3]


def confirm_depths(views: list[TrainingView], depths: list[np.ndarray]) -> list[np.ndarray]:
    """The depths that enough neighbouring views find too and that no others look through, 0 elsewhere."""
    cameras = [view.camera for view in views]
    neighbours = select_neighbours(cameras, min(WITNESSES, len(views) - 1))
    maps = []
    for view, depth, witnesses in zip(views, depths, neighbours, strict=True):
        agreeing = [np.abs(gap) < TOLERANCE for gap in _gaps(view, depth, cameras, depths, witnesses)]
        maps.append(_only(depth, np.sum(agreeing, axis=0) >= CONFIRMATIONS))
    result = []
    for view, depth in zip(views, maps, strict=True):
        contradicting = [gap > SEEN_THROUGH for gap in _gaps(view, depth, cameras, maps, range(len(views)))]
        result.append(_only(depth, np.sum(contradicting, axis=0) < SEEN_THROUGH_BY))
    return result


def _gaps(
    view: TrainingView, depth: np.ndarray, cameras: list[Camera], depths: list[np.ndarray], witnesses: Iterable[int]
) -> Iterator[np.ndarray]:
    """For each witness how far behind each of the (P,) known depths its own depth lies there, NaN where it has none."""
    y, x = np.nonzero(depth)
    world = _world_points(view, depth, y, x)
    for witness in witnesses:
        camera, other = cameras[witness], depths[witness]
        pixels, z = camera.project(world)
        u, v = np.floor(pixels).astype(int).T
        framed = np.flatnonzero((u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px))
        found = other[v[framed], u[framed]]
        gap = np.full(len(y), np.nan)
        gap[framed] = np.where(found > 0, found - z[framed], np.nan)
        yield gap


def _only(depth: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """`depth` with those of its (P,) known values that are `kept`, 0 elsewhere."""
    result = np.zeros_like(depth)
    y, x = np.nonzero(depth)
    result[y[kept], x[kept]] = depth[y[kept], x[kept]]
    return result


def _averaged(points: np.ndarray, attributes: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Means of the points, and of their attributes, in cubic cells of SPACING."""
    if len(points) == 0:
        return points, attributes
    _, cell, count = np.unique(np.floor(points / SPACING).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(cell, column, len(count)) / count for column in values.T], 1)

    return mean(points), [mean(attribute) for attribute in attributes]
