"""Seeds: surface points that several views confirm before any optimization, and the file that holds them (seeds.npz).

The visual hull closes every hollow with a lid. Wherever the surface has shading or print, stereo tells where it really is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere, crop_for_seeds, fit_object_sphere, grid_camera
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View, find_possible, read_object_masks
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

if TYPE_CHECKING:  # it imports torch, which takes longer than most steps that only read seeds
    from zeroshop_steps.surface.rendering.training_views import TrainingView

HULL_RESOLUTION = 128
"""Voxels along an edge of the cube of the visual hull."""
FIELDS = ("positions", "colors", "normals", "names", "shapes", "depths", "occupied", "half_extent", "centre", "radius")
"""Names of the arrays in the file, in the order in which they are written."""
WEIGHTS = "weights"
"""The one that is there only where given depth was joined."""


@dataclass(frozen=True)
class Seeds:
    """What stereo has found, in normalized coordinates.

    Attributes:
        positions: (N, 3). colors: (N, 3) RGB in [0, 1]. normals: (N, 3) unit, towards the views that found the seed.
        depth_maps: by the name of the view, (H, W) float32 depth along the optical axis at the pixels of its stereo grid,
            0 where nothing was confirmed.
        carved_hull: the visual hull, carved by the depths.
        weights: by the name of the view, (H, W) float32 how much each depth counts in training, at most 1; None where all count alike.
    """

    positions: np.ndarray
    colors: np.ndarray
    normals: np.ndarray
    depth_maps: dict[str, np.ndarray]
    carved_hull: VisualHull
    weights: dict[str, np.ndarray] | None = None


def carve_hull(grid: Sequence["TrainingView"]) -> VisualHull:
    """The visual hull of the masks, in normalized coordinates; grid: the views at the pixels at which stereo estimates planes."""
    masks = [view.find_possible() for view in grid]
    return VisualHull.carve([view.camera for view in grid], masks, half_extent=1.0, resolution=HULL_RESOLUTION, misses_allowed=1)


def write_seeds(path: Path, seeds: Seeds, sphere: ObjectSphere) -> None:
    """Write a compressed NumPy archive; the same seeds give the same bytes."""
    maps = list(seeds.depth_maps.values())
    occupied = seeds.carved_hull.occupied
    content: tuple[np.ndarray, ...] = (
        *(seeds.positions, seeds.colors, seeds.normals),
        np.array(list(seeds.depth_maps)),
        np.array([depth.shape for depth in maps]),
        np.concatenate([depth.ravel() for depth in maps]),
        np.packbits(occupied).reshape(len(occupied), -1),
        *(np.array(seeds.carved_hull.half_extent), sphere.centre, np.array(sphere.radius)),
    )
    arrays = dict(zip(FIELDS, content, strict=True))
    if seeds.weights is not None:
        arrays[WEIGHTS] = np.concatenate([seeds.weights[name].ravel() for name in seeds.depth_maps])
    with atomic_write(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def read_seeds(path: Path, sphere: ObjectSphere, cameras: Sequence[Camera]) -> Seeds:
    """Read what `write_seeds` wrote.

    Args:
        sphere: the object's.
        cameras: those of the crops in which stereo has looked for seeds.

    Raises:
        StepError: the file is missing, damaged, or was made from other images or cameras.
    """
    path = Path(path)
    if not path.is_file():
        raise StepError(f"{path} does not exist; run stereo first")
    try:
        with np.load(path, allow_pickle=False) as archive:
            positions, colors, normals, names, shapes, depths, packed, half_extent, centre, radius = (archive[name] for name in FIELDS)
            weights = _split(archive[WEIGHTS], names, shapes) if WEIGHTS in archive else None
        depth_maps = _split(depths, names, shapes)
        resolution = len(packed)
        occupied = np.unpackbits(packed)[: resolution**3].reshape((resolution,) * 3).astype(bool)
        if not positions.shape == colors.shape == normals.shape == (len(positions), 3):
            raise ValueError("points, colours and normals do not fit")
    except Exception as error:
        raise StepError(f"{path} is not a whole file of seeds ({type(error).__name__}); delete it and run stereo again") from None
    found = {name: depth.shape for name, depth in depth_maps.items()}
    expected = {grid.name: (grid.height_px, grid.width_px) for grid in map(grid_camera, cameras)}
    if found != expected or not (np.allclose(centre, sphere.centre, rtol=1e-9) and np.isclose(radius, sphere.radius, rtol=1e-9)):
        raise StepError(f"{path} belongs to other images or cameras than those given; run stereo on these")
    return Seeds(positions, colors, normals, depth_maps, VisualHull(occupied, float(half_extent)), weights)


def _split(values: np.ndarray, names: np.ndarray, shapes: np.ndarray) -> dict[str, np.ndarray]:
    """By name, maps of these shapes that were written one after the other."""
    parts = np.split(values, np.cumsum(shapes.prod(axis=1))[:-1])
    return {name: part.reshape(shape) for name, part, shape in zip(names.tolist(), parts, shapes, strict=True)}


def read_confirmed_points(path: Path, views: Sequence[View]) -> np.ndarray:
    """(N, 3) points of all confirmed depths in a seeds.npz, in the frame of the views' registration.

    Raises:
        StepError: the file is missing, damaged, or was made from other images or cameras.
    """
    cameras, masks = [view.camera for view in views], read_object_masks(views)
    sphere = fit_object_sphere(cameras, masks)
    possible = [find_possible(mask, view.confidence()) for mask, view in zip(masks, views, strict=True)]
    crops = [crop_for_seeds(camera, shown, sphere).camera for camera, shown in zip(cameras, possible, strict=True)]
    seeds = read_seeds(path, sphere, crops)
    points = [np.zeros((0, 3))]
    for camera in map(grid_camera, crops):
        depth = seeds.depth_maps[camera.name]
        rows, columns = np.nonzero(depth)
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
        seen = pixels @ np.linalg.inv(camera.intrinsics).T * depth[rows, columns, None]
        pose = camera.camera_from_world
        points.append((seen - pose[:3, 3]) @ pose[:3, :3])
    return sphere.centre + sphere.radius * np.concatenate(points)
