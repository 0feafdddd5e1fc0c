"""The voxels that training starts from: cells of the visual hull, dense behind the surface that stereo and masks suggest."""

import numpy as np
import torch
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, map_coordinates

from zeroshop_steps.geometry.observation.visual_hull import SMOOTHING_VOXELS, VisualHull
from zeroshop_steps.surface.rendering.spherical_harmonics import SH_CONSTANT
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.octree import CELLS, CORNER_OFFSETS, Octree
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.signed_distances import fuse_signed_distances
from zeroshop_steps.surface.svraster.voxels import Voxels
from zeroshop_steps.surface.training.initialization import Initialization, average_colors
from zeroshop_steps.surface.training.trainer import find_depth_targets

REACH = 0.06
"""Reach of confirmed depths around the surface, in normalized units."""
NEAR = 0.9
"""Leaves whose centre is nearer to the suggested surface than this many edge lengths are split: the surface may cross them."""
DEEP = 0.05
"""Leaves whose centre is deeper behind the suggested surface than this, in normalized units, are left out: no view sees them."""
RISE = 5.0
"""Rise of the density, before activation, across one of the finest leaves, with the depth behind the suggested surface."""
DENSITY_MIN, DENSITY_MAX = -4.0, 2.5
"""Bounds of the initial density, before activation: nearly clear, and opaque within one leaf."""
HALF_DENSITY = 0.8
"""Density, before activation, at the suggested surface: transmittance falls to one half a fraction of a leaf behind it."""
HULL_RISE, HULL_DENSITY = 1.0, -1.5
"""The same without stereo, where the surface lies somewhere inside the hull: so soft that light reaches the leaves behind, and training
moves it inwards. With the values above, the bulges of the hull of a carton stay."""
FILL_PX = 1.5
"""A confirmed depth stands for the pixels within this distance, since not every pixel has one."""


def initialize_voxels(initialization: Initialization, views: list[TrainingView], settings: VoxelSettings) -> Voxels:
    """The cells of a level that the visual hull meets and that are not wholly in free space, those near the surface split.

    Dense behind confirmed depths and thin before them; where there are none, dense behind the hull's surface. Without stereo, the
    whole hull is filled, denser with depth, and no cell split: training carves it, and splits where it has to (Sun et al. 2025). If
    all were thin, every voxel of a ray would explain its pixel a little, and training would end in a mist with holes. Colours are
    means over the views, the same from all sides.

    Args:
        initialization: free space and confirmed depths.
        views: the small views that these come from.
        settings: `level_start` is the level of the leaves away from the surface; those along it are of the next one.
    """
    level = settings.level_start
    free_space = initialization.free_space
    coarse = VisualHull.carve(free_space.cameras, free_space.masks, half_extent=1.0, resolution=1 << level, misses_allowed=1).occupied
    cells = np.argwhere(binary_dilation(coarse, np.ones((3, 3, 3), bool)))
    children = 2 * cells[:, None] + CORNER_OFFSETS
    solid = ~free_space.contains(((children.reshape(-1, 3) + 0.5) / (1 << level)) - 1.0).reshape(-1, 8)
    occupied = np.zeros((2 << level,) * 3, bool)
    occupied[tuple(children[solid].T)] = True
    met = cells[solid.any(axis=1)]
    octree = Octree.from_leaves(met * (CELLS >> level), np.full(len(met), level))
    if settings.initialization == "stereo":
        octree, densities = _split_along_surface(octree, _smooth_distances(initialization, views, occupied), level)
    else:
        densities = _densities_behind(octree, _hull_distances(occupied), level, HULL_DENSITY, HULL_RISE)
    outward = octree.centres / np.linalg.norm(octree.centres, axis=1, keepdims=True)
    colors = average_colors(octree.centres, outward, views)
    return Voxels(
        octree,
        torch.from_numpy(np.clip(densities, DENSITY_MIN, DENSITY_MAX).astype(np.float32)),
        torch.tensor((colors - 0.5) / SH_CONSTANT, dtype=torch.float32)[:, None, :],
        torch.zeros(len(octree), (settings.sh_degree + 1) ** 2 - 1, 3),
    )


def _split_along_surface(octree: Octree, grid: np.ndarray, level: int) -> tuple[Octree, np.ndarray]:
    """Leaves of the next level along the surface that a grid of distances suggests, and (M,) the density at all corners."""
    depth = _look_up(grid, octree.centres)
    octree, _ = octree.refine(depth > -DEEP, np.abs(depth) < NEAR * octree.sizes)
    return octree, _densities_behind(octree, grid, level + 1, HALF_DENSITY, RISE)


def _densities_behind(octree: Octree, grid: np.ndarray, finest_level: int, surface: float, rise: float) -> np.ndarray:
    """(M,) densities, before activation, at all corners of a tree: that at the surface of a grid of distances, and the rise behind it
    across one of the finest leaves."""
    edge = 2.0 / (1 << finest_level)
    return surface - rise / edge * _look_up(grid, octree.corner_points * (2.0 / CELLS) - 1.0)


def _look_up(grid: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P,) values at (P, 3) points of a grid over the root, interpolated between the centres of its cells."""
    return map_coordinates(grid, (points.T + 1.0) * (len(grid) / 2) - 0.5, order=1, mode="nearest")


def _depth_map(view: TrainingView, pixels: torch.Tensor, depths: torch.Tensor) -> np.ndarray:
    """(H, W) float32 depths of a view, from (K,) flat pixel indices and (K,) depths; 0 far from all of them."""
    depth = np.zeros((view.camera.height_px, view.camera.width_px), np.float32)
    depth.reshape(-1)[pixels.numpy()] = depths.numpy()
    if not depth.any():
        return depth
    distance, (y, x) = distance_transform_edt(depth == 0, return_indices=True)
    return np.where(distance <= FILL_PX, depth[y, x], np.float32(0.0))


def _smooth_distances(initialization: Initialization, views: list[TrainingView], occupied: np.ndarray) -> np.ndarray:
    """Distance to the suggested surface at the centres of the cells of a grid over the root, negative inside, in normalized units.

    Stereo's depths are sparse where the object is plain, and the hull has edges that it lacks: hence smooth.
    """
    by_hull = _hull_distances(occupied)
    near = np.argwhere(np.abs(by_hull) < 2 * REACH)
    points = (near + 0.5) * (2.0 / len(occupied)) - 1.0
    cameras, depths = [view.camera for view in views], [_depth_map(view, *find_depth_targets(view, initialization)[:2]) for view in views]
    by_depth = fuse_signed_distances(points, cameras, depths, REACH, zero_is_free=False, min_views=1)
    known = (by_depth > -REACH) & occupied[tuple(near.T)]
    distances = np.clip(by_hull, -REACH, REACH)
    distances[tuple(near[known].T)] = by_depth[known]
    return gaussian_filter(distances, SMOOTHING_VOXELS)


def _hull_distances(occupied: np.ndarray) -> np.ndarray:
    """Distance to the hull's surface at the centres of the cells of a grid over the root, negative inside, in normalized units."""
    # Between the centres of a cell within and one without, each half an edge from it, lies the surface.
    return np.where(occupied, 0.5 - distance_transform_edt(occupied), distance_transform_edt(~occupied) - 0.5) * (2.0 / len(occupied))
