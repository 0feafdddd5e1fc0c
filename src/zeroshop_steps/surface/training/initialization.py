"""What training starts from: points on and near the surface, free space, and the depths that are known there.

These come from stereo, or from the registration's sparse points alone (sparse_start.py)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import Camera, SparseModel
from zeroshop_steps.geometry.observation.visual_hull import find_inside_masks
from zeroshop_steps.surface.mvs.depth_maps import ray_slopes
from zeroshop_steps.surface.mvs.free_space import HullDistanceField
from zeroshop_steps.surface.mvs.seeds import Seeds
from zeroshop_steps.surface.rendering.training_views import TrainingView, make_grid_view

FREE_SPACE_VOXELS = 2.5
"""What lies farther than this from the carved hull is free space."""
NORMAL_NEIGHBOURS = 12
"""Nearest seeds through which a plane is fitted for a seed's normal."""
TRACK_LENGTH_MIN = 3
"""Sparse points that fewer images see are not trusted."""
SPARSE_RADIUS_MAX = 1.2
"""Nor are those farther than this from the object's centre, whose sphere has radius 1."""


@dataclass(frozen=True)
class FreeSpace:
    """Where no surface can be: outside the masks, and away from the carved hull.

    Attributes:
        cameras, masks: those of the views, the masks (H, W) bool.
        hull_distance: the distance from the carved hull, which is what stereo leaves of the visual hull.
    """

    cameras: list[Camera]
    masks: list[np.ndarray]
    hull_distance: HullDistanceField

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(P,) bool: which (P, 3) points lie in free space."""
        outside = ~find_inside_masks(points, self.cameras, self.masks, misses_allowed=1)
        return outside | self.hull_distance.farther_than(points, FREE_SPACE_VOXELS)


@dataclass(frozen=True)
class Initialization:
    """What is known before training, in normalized coordinates.

    Attributes:
        points, colors, normals: (N, 3) initial points, RGB in [0, 1], unit normals.
        free_space: where no surfel and no voxel may be.
        confirmed_rays, confirmed_depths: by the name of the view, (K, 2) slopes x / z and y / z of rays in its camera, and
            (K,) depths along them that stereo has confirmed, or of sparse points.
        confirmed_weights: (K,) how much each counts.
    """

    points: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    free_space: FreeSpace
    confirmed_rays: dict[str, np.ndarray]
    confirmed_depths: dict[str, np.ndarray]
    confirmed_weights: dict[str, np.ndarray]


def make_initialization(
    model: SparseModel, sphere: ObjectSphere, views: list[TrainingView], seeds: Seeds, hull_points: int, seed: int
) -> Initialization:
    """Join three sources of points: those of the sparse model, the seeds of stereo, and the carved hull where neither has any.

    Args:
        model: the registration's, whose sparse points are in its world frame.
        sphere: the object's, which normalizes them.
        views: the views in which the seeds were found.
        hull_points: how many points of the hull are taken, at most.
        seed: of their random choice.
    """
    grid = [make_grid_view(view) for view in views]
    cameras = [view.camera for view in grid]
    masks = [view.find_possible() for view in grid]
    free_space = FreeSpace(cameras, masks, HullDistanceField.from_hull(seeds.carved_hull))
    seed_normals = _fit_normals(seeds.positions, seeds.normals)

    sparse = (model.points - sphere.centre) / sphere.radius
    trusted = (model.track_lengths >= TRACK_LENGTH_MIN) & (np.linalg.norm(sparse, axis=1) < SPARSE_RADIUS_MAX)
    trusted[trusted] = find_inside_masks(sparse[trusted], cameras, masks, misses_allowed=1)
    sparse = sparse[trusted]

    surface, surface_normals = seeds.carved_hull.surface()
    confirmed = np.concatenate([seeds.positions, sparse])
    if len(confirmed) and len(surface):
        lone = cKDTree(confirmed).query(surface)[0] > 2.0 / len(seeds.carved_hull.occupied)
        surface, surface_normals = surface[lone], surface_normals[lone]
    chosen = np.random.default_rng(seed).permutation(len(surface))[:hull_points]
    surface, surface_normals = surface[chosen], surface_normals[chosen]

    others, other_normals = np.concatenate([seeds.positions, surface]), np.concatenate([seed_normals, surface_normals])
    if len(others) == 0:
        others, other_normals = seeds.carved_hull.surface()
    if len(others) == 0:  # no point has a normal that sparse points could take over
        sparse, trusted = sparse[:0], np.zeros_like(trusted)
    sparse_normals = np.zeros((0, 3))
    if len(sparse):
        sparse_normals = other_normals[cKDTree(others).query(sparse)[1]]
    return Initialization(
        np.concatenate([sparse, seeds.positions, surface]),
        np.concatenate([model.colors[trusted] / 255.0, seeds.colors, average_colors(surface, surface_normals, grid)]),
        np.concatenate([sparse_normals, seed_normals, surface_normals]),
        free_space,
        *_gather_confirmed_depths(grid, seeds),
    )


def _gather_confirmed_depths(views: list[TrainingView], seeds: Seeds) -> tuple[dict[str, np.ndarray], ...]:
    """By the name of each view, (K, 2) slopes of rays, (K,) the depths along them that stereo has confirmed, and (K,) their weights."""
    rays, depths, weights = {}, {}, {}
    for view in views:
        name, depth = view.camera.name, seeds.depth_maps[view.camera.name]
        y, x = np.nonzero(depth)
        rays[name], depths[name] = ray_slopes(view.camera, y, x), depth[y, x]
        weights[name] = np.ones(len(y), np.float32) if seeds.weights is None else seeds.weights[name][y, x]
    return rays, depths, weights


def _fit_normals(points: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(N, 3) normals of the planes through each point's nearest neighbours, on the side of `towards` (N, 3)."""
    if len(points) < NORMAL_NEIGHBOURS:
        return towards
    near = points[cKDTree(points).query(points, k=NORMAL_NEIGHBOURS)[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]
    return normals * np.where((normals * towards).sum(axis=1) < 0, -1.0, 1.0)[:, None]


def average_colors(points: np.ndarray, normals: np.ndarray, views: list[TrainingView]) -> np.ndarray:
    """(N, 3) mean RGB of (N, 3) points over the views, weighted by the cosine between normal and direction to the camera."""
    total, weight = np.zeros((len(points), 3)), np.full((len(points), 1), 1e-6)
    for view in views:
        pixels, _ = view.camera.project(points)
        x = pixels[:, 0].astype(int).clip(0, view.camera.width_px - 1)
        y = pixels[:, 1].astype(int).clip(0, view.camera.height_px - 1)
        towards = view.camera.centre_in_world - points
        facing = np.maximum((normals * towards).sum(1) / np.linalg.norm(towards, axis=1), 0.0)[:, None]
        total += facing * view.color.numpy()[:, y, x].T
        weight += facing
    return (total / weight).clip(0, 1)
