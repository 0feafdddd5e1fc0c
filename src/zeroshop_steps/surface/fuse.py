"""Fuse the depth maps of trained surfels into a raw mesh by truncated signed distances (TSDF; Curless & Levoy 1996).

Each registered camera renders a depth map; depths outside its mask, and where the surfels are translucent, are left out.
Open3D's voxel blocks integrate the maps, marching cubes extracts the surface, and a small offset brings its silhouettes
onto the masks.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.meshing.raw_mesh import OFFSET_VOXELS, extract_mesh, make_tsdf_grid, read_mesh_views, write_raw_mesh
from zeroshop_steps.surface.meshing.silhouette_offset import fit_to_masks
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.losses import SOLID_ALPHA
from zeroshop_steps.surface.twodgs.render import RenderView, render_surface_depth
from zeroshop_steps.surface.twodgs.surfels import Surfels, read_splat_ply
from zeroshop_steps.surface.twodgs.train import SCALE_MAX

TRUNCATION_VOXELS = 5.0
"""Half width of the band in which distances are kept, as in 2DGS. Three keep walls thinner (YCB bowl with depth images: F 0.955 and 0.734
of two captures, 0.958 and 0.777 with three), but where depth maps of photos agree less, the surface falls into parts: the silhouettes of
a tissue box overlap with its masks by 0.975, with three by 0.955."""
SURFACE_REACH = SCALE_MAX / 2
"""Surfels within this of a pixel's median depth, in normalized units, belong to the same surface: half of the widest surfel."""
EXTENT_QUANTILES = (0.01, 0.99)
"""The object's box, whose longest side is divided into voxels, holds the surfels between these quantiles: a few may lie far off."""
BLOCKS_AT_FIRST = 4_000
"""Room for blocks of voxels, 32 kB each; the grid grows where it needs more. Clearing room that stays empty takes time."""
DEPTH_RANGE = (1.0, 1e3)
"""Open3D divides depths by the first and ignores those beyond the second."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--model", type=Path, required=True, help="splats.ply of the training")
    parser.add_argument("--cameras", type=Path, required=True, help="folder of the registration that the training used")
    parser.add_argument("--voxels", type=int, default=256, help="voxels along the longest side of the object's box")
    parser.add_argument("--image-width-px", type=int, default=1000, help="width at which depth is rendered, at most that of the images")
    parser.add_argument("--min-views", type=int, default=2, help="surface that fewer views have seen is left out")
    parser.add_argument("--out", type=Path, required=True, help="raw mesh, PLY in the registration's frame")


def run(args: argparse.Namespace) -> None:
    start_s = time.monotonic()
    surfels, sphere = read_splat_ply(args.model)
    views = read_mesh_views(args.cameras, sphere, args.image_width_px)
    depths = [render_depth(surfels, view) for view in views]
    mesh = fuse_depth_maps(depths, views, surfels, args.voxels, args.min_views)
    if mesh is None:
        raise StepError(f"{args.model} has no surface that {args.min_views} views see; train longer or check masks and cameras")
    voxel = np.ptp(mesh.vertices, axis=0).max() / args.voxels
    mesh, offset = fit_to_masks(mesh, views, limit=OFFSET_VOXELS * voxel)
    write_raw_mesh(args.out, mesh, sphere, args.voxels, offset / voxel, start_s)


def render_depth(surfels: Surfels, view: TrainingView) -> np.ndarray:
    """(H, W) float32 depth of one view in normalized units; 0 outside the mask, and where the surfels are translucent."""
    render_view = RenderView.from_training_view(view)
    depth, alpha = render_surface_depth(
        surfels.positions, surfels.log_scales, surfels.quaternions, surfels.opacity_logits, render_view, SURFACE_REACH
    )
    return np.where((alpha > SOLID_ALPHA) & (view.mask.numpy() > 0.5), depth, np.float32(0.0))


def fuse_depth_maps(depths: list[np.ndarray], views: list[TrainingView], surfels: Surfels, voxels: int, min_views: int) -> Mesh | None:
    """The surface that depth maps agree on, in normalized coordinates; None when there is none.

    Args:
        depths: for each view, (H, W) float32 depth along the optical axis, 0 where there is none.
        voxels: how many fit along the longest side of the surfels' box.
        min_views: surface that fewer views have seen is left out.
    """
    positions = surfels.positions.numpy()
    low, high = EXTENT_QUANTILES
    spread = np.quantile(positions, high, axis=0) - np.quantile(positions, low, axis=0)
    grid = make_tsdf_grid(float(spread.max()) / voxels, BLOCKS_AT_FIRST)
    for depth, view in zip(depths, views, strict=True):
        # Open3D puts pixel centres at integers.
        intrinsics = view.camera.intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        k, pose = o3d.core.Tensor(intrinsics), o3d.core.Tensor(view.camera.camera_from_world)
        image = o3d.t.geometry.Image(np.ascontiguousarray(depth[:, :, None]))
        if not depth.any():
            continue
        blocks = grid.compute_unique_block_coordinates(image, k, pose, *DEPTH_RANGE, TRUNCATION_VOXELS)
        grid.integrate(blocks, image, k, pose, *DEPTH_RANGE, TRUNCATION_VOXELS)
    return extract_mesh(grid, weight_min=min_views - 0.5)
