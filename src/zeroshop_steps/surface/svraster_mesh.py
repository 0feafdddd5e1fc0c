"""A raw mesh straight from trained voxels: marching cubes (Lorensen & Cline 1987) over the density at their corners.

Leaves of all levels are interpolated onto one lattice, so that no crack opens where levels meet. Density is trusted within a narrow
band around the surface that the voxels' depth maps show: training leaves wisps elsewhere. What no camera sees counts
as inside, so that the thin shell that training leaves of an object has one side; a small offset brings the silhouettes onto
the masks, and what too few cameras see of the surface is left out.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from zeroshop_steps.geometry.meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.fuse import sort_mesh
from zeroshop_steps.surface.silhouettes import fit_to_masks
from zeroshop_steps.surface.svraster.density_grid import DensityGrid, fuse_signed_distances, half_opacity_value
from zeroshop_steps.surface.svraster.render import RenderView, render
from zeroshop_steps.surface.svraster.voxels import Voxels, read_voxels
from zeroshop_steps.surface.training_views import TrainingView, make_training_views, read_camera_set

BLOCK = 16
"""Lattice points along an edge of a block of Open3D's grid."""
REACH_STEPS = 4.0
"""Depth maps are averaged within this many steps of the lattice around the surface that they show."""
MIN_VIEWS = 2
"""What fewer views see counts as hidden: one wrong depth digs no tunnel."""
BAND_STEPS = 1.5
"""The density draws the surface within this many steps of the one that the depths show."""
COSINE_MIN = 0.15
"""Cosine of the angle between normal and ray from which a face counts as facing a camera."""
SMOOTH_STEPS = 1.0
"""Standard deviation, in steps of the lattice, by which distances are smoothed: colour says nothing of ripples this fine."""
SOFT = 4.0
"""Values are clipped this far around the surface's: no crossing is drawn towards a far value."""
OFFSET_STEPS = 2.0
"""Most that the surface is moved to meet the masks."""
SEEN_STEPS = 2.0
"""What lies within this many steps of the surface that a view shows is seen by it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--voxels-file", type=Path, required=True, help="voxels.npz of the training")
    parser.add_argument("--cameras", type=Path, required=True, help="the registration that the training used")
    parser.add_argument("--image-width-px", type=int, default=800, help="width at which depth is rendered, at most that of the images")
    parser.add_argument("--out", type=Path, required=True, help="raw mesh, PLY in the registration's frame")


def run(args: argparse.Namespace) -> None:
    start_s = time.monotonic()
    voxels, sphere = read_voxels(args.voxels_file)
    views = make_training_views(read_camera_set(args.cameras), sphere, args.image_width_px, border_px=1)
    field = DensityGrid.from_octree(voxels.octree, voxels.densities.numpy(), border=2)
    depths = [render_depth(voxels, view) for view in views]
    mesh = extract_surface(field, views, depths)
    if mesh is None:
        raise StepError(f"{args.voxels_file} has no surface; train longer or check masks and cameras")
    mesh, offset = fit_to_masks(mesh, views, limit=OFFSET_STEPS * field.step)
    mesh = keep_seen(mesh, views, depths, SEEN_STEPS * field.step)
    if len(mesh.faces) == 0:
        raise StepError(f"{args.voxels_file} has no surface that {MIN_VIEWS} views see; train longer or check masks and cameras")
    world = Mesh(mesh.vertices * sphere.radius + sphere.centre, mesh.faces)
    write_ply(args.out, world)
    figures = {
        "seconds": round(time.monotonic() - start_s, 2),
        "vertices": len(world.vertices),
        "faces": len(world.faces),
        "voxels": len(voxels),
        "offset_voxels": round(offset / field.step, 3),
    }
    write_json(args.out.with_suffix(".json"), figures)


def render_depth(voxels: Voxels, view: TrainingView) -> np.ndarray:
    """(H, W) float32 depth at which half of the light of each pixel is stopped; 0 outside the mask and where less is stopped."""
    with torch.no_grad():
        rendering = render(voxels.octree, voxels.densities, torch.zeros(len(voxels), 1, 3), 0, RenderView.from_training_view(view))
    return np.where(view.mask.numpy() > 0.5, rendering.median_depth.numpy(), np.float32(0.0))


def extract_surface(field: DensityGrid, views: list[TrainingView], depths: list[np.ndarray]) -> Mesh | None:
    """The surface of a field, in normalized coordinates; None when there is none.

    Args:
        depths: (H, W) depth of the surface in each view, 0 where it sees past the object; the density draws the surface within a narrow
            band around the one that they show.
    """
    points = field.points(np.argwhere(np.ones(field.values.shape, bool)))
    cameras, reach = [view.camera for view in views], REACH_STEPS * field.step
    values = -fuse_signed_distances(points, cameras, depths, reach, zero_is_free=True, min_views=MIN_VIEWS).reshape(field.values.shape)
    density = np.where(field.covered, np.clip(field.values - half_opacity_value(field.step), -SOFT, SOFT), -SOFT)
    values = np.where(np.abs(values) < BAND_STEPS * field.step, density, np.sign(values) * SOFT)
    values = gaussian_filter(values, SMOOTH_STEPS)
    outside = values.min()
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = outside
    mesh = marching_cubes(values.astype(np.float32))
    return mesh and Mesh(field.points(mesh.vertices), mesh.faces)


def keep_seen(mesh: Mesh, views: list[TrainingView], depths: list[np.ndarray], reach: float) -> Mesh:
    """The part of a mesh that lies, within `reach`, on the surface that enough views show, and faces some camera.

    The rest, such as the underside and the walls of what no camera looks into, is a guess.

    Args:
        depths: (H, W) depth of the surface in each view, 0 where it sees past the object.
    """
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    cosine, shown = np.full(len(normals), -1.0), np.zeros(len(mesh.vertices), int)
    for view, depth in zip(views, depths, strict=True):
        towards = view.camera.centre_in_world - corners[:, 0]
        np.maximum(cosine, np.einsum("fi,fi->f", normals, towards) / np.linalg.norm(towards, axis=1), out=cosine)
        pixels, z = view.camera.project(mesh.vertices)
        x, y = np.floor(pixels).astype(int).T
        framed = np.flatnonzero((x >= 0) & (y >= 0) & (x < view.camera.width_px) & (y < view.camera.height_px))
        shown[framed] += np.abs(depth[y[framed], x[framed]] - z[framed]) < reach
    kept = (cosine > COSINE_MIN) & (shown[mesh.faces] >= MIN_VIEWS).all(axis=1)
    used, faces = np.unique(mesh.faces[kept], return_inverse=True)
    return Mesh(mesh.vertices[used], faces.reshape(-1, 3))


def marching_cubes(values: np.ndarray) -> Mesh | None:
    """The surface where (X, Y, Z) float32 values pass zero, facing the negative side, in units of the lattice; None when there is none."""
    if values.min() > 0 or values.max() < 0:
        return None
    padded = np.pad(values, [(0, -size % BLOCK) for size in values.shape], constant_values=values.min())
    x, y, z = (size // BLOCK for size in padded.shape)
    blocks = padded.reshape(x, BLOCK, y, BLOCK, z, BLOCK).transpose(0, 2, 4, 5, 3, 1).reshape(x * y * z, -1)
    keys = np.argwhere(np.ones((x, y, z), bool)).astype(np.int32)
    grid = o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1), (1)), 1.0, BLOCK, len(keys))
    places, _ = grid.hashmap().activate(o3d.core.Tensor(keys))
    grid.attribute("tsdf")[places.to(o3d.core.int64)] = o3d.core.Tensor(-blocks.reshape(len(keys), BLOCK, BLOCK, BLOCK, 1))
    grid.attribute("weight")[places.to(o3d.core.int64)] = o3d.core.Tensor(np.ones((len(keys), BLOCK, BLOCK, BLOCK, 1), np.float32))
    found = grid.extract_triangle_mesh(weight_threshold=0.5)
    vertices, faces = found.vertex.positions.numpy().astype(float), found.triangle.indices.numpy().astype(np.int64)
    return sort_mesh(vertices, faces) if len(faces) else None
