"""Where training starts: which points on and around the object the images vouch for before any optimization."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.cameras import Camera, SparseModel
from zeroshop_steps.geometry.crops import ObjectSphere
from zeroshop_steps.geometry.visual_hull import find_inside_masks
from zeroshop_steps.surface.free_space import HullDistanceField
from zeroshop_steps.surface.seeds import Seeds
from zeroshop_steps.surface.training_views import TrainingView, make_grid_view

OUTSIDE_VOXELS = 2.5
"""Disks farther than this from the carved volume are in free space."""
NORMAL_NEIGHBOURS = 12


@dataclass(frozen=True)
class FreeSpace:
    """Where no surface can be: outside the masks, and away from the carved volume.

    Attributes:
        cameras, masks: the views that judge and their (H, W) bool masks.
        volume: where stereo leaves room for the object.
    """

    cameras: list[Camera]
    masks: list[np.ndarray]
    volume: HullDistanceField

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(P,) bool for (P, 3) points."""
        outside = ~find_inside_masks(points, self.cameras, self.masks, misses_allowed=1)
        return outside | self.volume.farther_than(points, OUTSIDE_VOXELS)


@dataclass(frozen=True)
class Initialization:
    """What is known before training, in normalized coordinates.

    Attributes:
        points, colors, normals: (N, 3) starting points, RGB in [0, 1], unit normals.
        free_space: where no disk may be.
        confirmed_rays, confirmed_depths: by the name of the view, (K, 2) slopes x / z and y / z of rays in its camera, and
            (K,) depths along them that stereo has confirmed.
    """

    points: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    free_space: FreeSpace
    confirmed_rays: dict[str, np.ndarray]
    confirmed_depths: dict[str, np.ndarray]


def make_initialization(
    model: SparseModel, sphere: ObjectSphere, views: list[TrainingView], seeds: Seeds, hull_points: int, seed: int
) -> Initialization:
    """Join three sources of points: the sparse model's, stereo's, and the carved hull where neither has any.

    Args:
        model: sparse points of the registration, in its world frame.
        views: the views that the seeds were found in.
        hull_points: how many of the hull's points, at most.
    """
    grid = [make_grid_view(view) for view in views]
    cameras = [view.camera for view in grid]
    masks = [view.mask.numpy() > 0 for view in grid]
    volume = seeds.volume
    free_space = FreeSpace(cameras, masks, HullDistanceField.from_hull(volume))
    seed_normals = _plane_normals(seeds.positions, seeds.normals)

    sparse = (model.points - sphere.centre) / sphere.radius
    trusted = (model.track_lengths >= 3) & (np.linalg.norm(sparse, axis=1) < 1.2)
    trusted[trusted] = find_inside_masks(sparse[trusted], cameras, masks, misses_allowed=1)
    sparse = sparse[trusted]

    surface, surface_normals = volume.surface()
    confirmed = np.concatenate([seeds.positions, sparse])
    if len(confirmed) and len(surface):
        lone = cKDTree(confirmed).query(surface)[0] > 2.0 / len(volume.occupied)
        surface, surface_normals = surface[lone], surface_normals[lone]
    chosen = np.random.default_rng(seed).permutation(len(surface))[:hull_points]
    surface, surface_normals = surface[chosen], surface_normals[chosen]

    others = np.concatenate([seeds.positions, surface])
    if len(others) == 0:  # nothing to take a normal from
        sparse, trusted = sparse[:0], np.zeros_like(trusted)
    sparse_normals = np.zeros((0, 3))
    if len(sparse):
        sparse_normals = np.concatenate([seed_normals, surface_normals])[cKDTree(others).query(sparse)[1]]
    return Initialization(
        np.concatenate([sparse, seeds.positions, surface]),
        np.concatenate([model.colors[trusted] / 255.0, seeds.colors, average_colors(surface, surface_normals, grid)]),
        np.concatenate([sparse_normals, seed_normals, surface_normals]),
        free_space,
        *_confirmed_rays(grid, seeds),
    )


def _confirmed_rays(views: list[TrainingView], seeds: Seeds) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    rays, depths = {}, {}
    for view in views:
        depth = seeds.depth_maps[view.camera.name]
        y, x = np.nonzero(depth)
        k = view.camera.intrinsics
        rays[view.camera.name] = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1]], 1)
        depths[view.camera.name] = depth[y, x]
    return rays, depths


def _plane_normals(points: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(N, 3) normals of planes through each point's nearest neighbours, on the side of `towards` (N, 3)."""
    if len(points) < NORMAL_NEIGHBOURS:
        return towards
    near = points[cKDTree(points).query(points, k=NORMAL_NEIGHBOURS)[1]]
    centred = near - near.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]
    return normals * np.where((normals * towards).sum(axis=1) < 0, -1.0, 1.0)[:, None]


def average_colors(points: np.ndarray, normals: np.ndarray, views: list[TrainingView]) -> np.ndarray:
    """(N, 3) mean RGB of (N, 3) points over the views that they face, weighted by how much."""
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
