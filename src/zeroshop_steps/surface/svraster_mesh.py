"""Extract a raw mesh from trained voxels: marching cubes (Lorensen & Cline 1987) over the density at their corners.

Leaves of all levels are interpolated onto one lattice, so that no crack opens where levels meet. Training leaves wisps of
density everywhere; the density is trusted only within a narrow band around the surface that the voxels' depth maps show.
What no camera sees counts as inside, so that the thin shell that training leaves of an object becomes one surface, not
two. A small offset brings the silhouettes onto the masks, and surface that too few cameras see is left out.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.meshing.raw_mesh import OFFSET_VOXELS, read_mesh_views, sort_mesh, write_raw_mesh
from zeroshop_steps.surface.meshing.silhouette_offset import fit_to_masks
from zeroshop_steps.surface.mvs.depth_maps import look_up_depths
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.density_grid import DensityGrid, fuse_signed_distances, half_opacity_value
from zeroshop_steps.surface.svraster.render import RenderView, render
from zeroshop_steps.surface.svraster.voxels import Voxels, read_voxels

# The bounds below were tuned on the demo mustard bottle. A step is the distance of two points of the lattice.
REACH_STEPS = 4.0
"""Depth maps are averaged within this many steps around the surface that they show."""
BAND_STEPS = 1.5
"""The density draws the surface within this many steps of the one that the depth maps show."""
SMOOTH_STEPS = 1.0
"""Standard deviation, in steps, by which values are smoothed: colour says nothing about ripples this fine."""
CLIP = 4.0
"""Values, before activation, are clipped this far around the surface's. Otherwise one far value would shift the crossing."""
SEEN_STEPS = 2.0
"""A vertex within this many steps of the surface that a view shows is seen by the view."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--model", type=Path, required=True, help="voxels.npz of the training")
    parser.add_argument("--cameras", type=Path, required=True, help="folder of the registration that the training used")
    parser.add_argument("--image-width-px", type=int, default=800, help="width at which depth is rendered, at most that of the images")
    parser.add_argument("--out", type=Path, required=True, help="raw mesh, PLY in the registration's frame")


def run(args: argparse.Namespace) -> None:
    start_s = time.monotonic()
    voxels, sphere = read_voxels(args.model)
    views = read_mesh_views(args.cameras, sphere, args.image_width_px)
    grid = DensityGrid.from_octree(voxels.octree, voxels.densities.numpy(), border=2)
    depths = [render_depth(voxels, view) for view in views]
    mesh = extract_surface(grid, views, depths)
    if mesh is None:
        raise StepError(f"{args.model} has no surface; train longer or check masks and cameras")
    mesh, offset = fit_to_masks(mesh, views, limit=OFFSET_VOXELS * grid.step)
    mesh = keep_seen(mesh, views, depths, SEEN_STEPS * grid.step)
    if len(mesh.faces) == 0:
        raise StepError(f"{args.model} has no surface that {AGREEING_VIEWS} views see; train longer or check masks and cameras")
    write_raw_mesh(args.out, mesh, sphere, len(voxels), offset / grid.step, start_s)


def render_depth(voxels: Voxels, view: TrainingView) -> np.ndarray:
    """(H, W) float32 depth at which half of the light of each pixel is stopped; 0 outside the mask and where less is stopped."""
    with torch.no_grad():
        rendering = render(voxels.octree, voxels.densities, torch.zeros(len(voxels), 1, 3), 0, RenderView.from_training_view(view))
    return np.where(view.mask.numpy() > 0.5, rendering.median_depth.numpy(), np.float32(0.0))


def extract_surface(grid: DensityGrid, views: list[TrainingView], depths: list[np.ndarray]) -> Mesh | None:
    """The surface of a grid of densities, in normalized coordinates; None when there is none.

    Args:
        depths: for each view, (H, W) depth of the surface, 0 where the view sees past the object. The density draws the
            surface within a narrow band around the one that they show.
    """
    points = grid.points(np.argwhere(np.ones(grid.values.shape, bool)))
    cameras, reach = [view.camera for view in views], REACH_STEPS * grid.step
    values = -fuse_signed_distances(points, cameras, depths, reach, zero_is_free=True, min_views=AGREEING_VIEWS).reshape(grid.values.shape)
    density = np.where(grid.covered, np.clip(grid.values - half_opacity_value(grid.step), -CLIP, CLIP), -CLIP)
    values = np.where(np.abs(values) < BAND_STEPS * grid.step, density, np.sign(values) * CLIP)
    values = gaussian_filter(values, SMOOTH_STEPS)
    outside = values.min()
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = outside
    mesh = extract_level_set(values.astype(np.float32))
    return mesh and Mesh(grid.points(mesh.vertices), mesh.faces)


def keep_seen(mesh: Mesh, views: list[TrainingView], depths: list[np.ndarray], reach: float) -> Mesh:
    """The faces that lie, within `reach`, on the surface that enough views show, and that face some camera.

    The rest is a guess, for example the underside, and the walls of a hollow that no camera looks into.

    Args:
        depths: for each view, (H, W) depth of the surface, 0 where the view sees past the object.
    """
    normals, corners = mesh.face_normals(), mesh.vertices[mesh.faces[:, 0]]
    cosine, shown = np.full(len(normals), -1.0), np.zeros(len(mesh.vertices), int)
    for view, depth in zip(views, depths, strict=True):
        towards = view.camera.centre_in_world - corners
        np.maximum(cosine, np.einsum("fi,fi->f", normals, towards) / np.linalg.norm(towards, axis=1), out=cosine)
        framed, surface, own = look_up_depths(view.camera, depth, mesh.vertices)
        shown[framed] += np.abs(surface - own) < reach
    kept = (cosine > GRAZING_COSINE) & (shown[mesh.faces] >= AGREEING_VIEWS).all(axis=1)
    return Mesh(mesh.vertices, mesh.faces[kept]).without_loose_vertices()


def extract_level_set(values: np.ndarray) -> Mesh | None:
    """The surface where (X, Y, Z) float32 values pass zero, facing the negative side; None when there is none.

    Vertices are in units of the lattice.
    """
    if values.min() > 0 or values.max() < 0:
        return None
    vertices, faces, _, _ = marching_cubes(-values, 0.0)
    return sort_mesh(vertices.astype(float), faces.astype(np.int64))
