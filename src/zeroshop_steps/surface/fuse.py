"""Fuse the depth maps of trained splats into a raw mesh (truncated signed distances; Curless & Levoy 1996).

Each registered camera renders its depth; depths outside its mask or where the splats are translucent are left out.
Open3D's voxel blocks integrate them, marching cubes takes the surface, and a small offset brings its silhouettes onto the masks.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import StepError, is_out_of_memory
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.silhouettes import fit_to_masks
from zeroshop_steps.surface.training_views import TrainingView, make_training_views, read_camera_set
from zeroshop_steps.surface.twodgs.render import RenderView, render_surface_depth
from zeroshop_steps.surface.twodgs.surfels import Surfels, read_splat_ply

TRUNCATION_VOXELS = 5.0
"""Half width of the band in which distances are kept (2DGS: five voxels)."""
SURFACE_REACH = 0.04
"""Disks within this of a pixel's median depth, in normalized units, are one surface with it."""
OFFSET_VOXELS = 2.0
"""Most that the surface is moved to meet the masks."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--splats", type=Path, required=True, help="splats.ply of the training")
    parser.add_argument("--cameras", type=Path, required=True, help="the registration that the training used")
    parser.add_argument("--voxels", type=int, default=256, help="voxels along the longest side of the object's box")
    parser.add_argument("--image-width-px", type=int, default=1000, help="width at which depth is rendered, at most that of the images")
    parser.add_argument("--min-views", type=int, default=2, help="surface that fewer views have seen is left out")
    parser.add_argument("--out", type=Path, required=True, help="raw mesh, PLY in the registration's frame")


def run(args: argparse.Namespace) -> None:
    start_s = time.monotonic()
    surfels, sphere = read_splat_ply(args.splats)
    views = make_training_views(read_camera_set(args.cameras), sphere, args.image_width_px, border_px=1)
    depths = [render_depth(surfels, view) for view in views]
    mesh = fuse_depth_maps(depths, views, surfels, args.voxels, args.min_views)
    if mesh is None:
        raise StepError(f"{args.splats} has no surface that {args.min_views} views see; train longer or check masks and cameras")
    voxel = np.ptp(mesh.vertices, axis=0).max() / args.voxels
    mesh, offset = fit_to_masks(mesh, views, limit=OFFSET_VOXELS * voxel)
    world = Mesh(mesh.vertices * sphere.radius + sphere.centre, mesh.faces)
    write_ply(args.out, world)
    figures = {
        "seconds": round(time.monotonic() - start_s, 2),
        "vertices": len(world.vertices),
        "faces": len(world.faces),
        "voxels": args.voxels,
        "offset_voxels": round(offset / voxel, 3),
    }
    write_json(args.out.with_suffix(".json"), figures)


def render_depth(surfels: Surfels, view: TrainingView) -> np.ndarray:
    """(H, W) float32 depth of one view in normalized units; 0 outside the mask and where less than half of the light is stopped."""
    render_view = RenderView.from_training_view(view)
    depth, alpha = render_surface_depth(
        surfels.positions, surfels.log_scales, surfels.quaternions, surfels.opacity_logits, render_view, SURFACE_REACH
    )
    return np.where((alpha > 0.5) & (view.mask.numpy() > 0.5), depth, np.float32(0.0))


def fuse_depth_maps(depths: list[np.ndarray], views: list[TrainingView], surfels: Surfels, voxels: int, min_views: int) -> Mesh | None:
    """The surface that depth maps agree on, in normalized coordinates; None when there is none.

    Vertices and faces are put in a fixed order, since the voxel blocks' hash map keeps none.
    """
    positions = surfels.positions.numpy()
    spread = np.quantile(positions, 0.99, axis=0) - np.quantile(positions, 0.01, axis=0)
    voxel = float(spread.max()) / voxels
    grid = o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1), (1)), voxel, 16, 20_000)
    for depth, view in zip(depths, views, strict=True):
        # Open3D puts pixel centres at integers.
        intrinsics = view.camera.intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        k, pose = o3d.core.Tensor(intrinsics), o3d.core.Tensor(view.camera.camera_from_world)
        image = o3d.t.geometry.Image(np.ascontiguousarray(depth[:, :, None]))
        if not depth.any():
            continue
        blocks = grid.compute_unique_block_coordinates(image, k, pose, 1.0, 1e3, TRUNCATION_VOXELS)
        grid.integrate(blocks, image, k, pose, 1.0, 1e3, TRUNCATION_VOXELS)
    try:
        surface = grid.extract_triangle_mesh(weight_threshold=min_views - 0.5)
    except RuntimeError as error:  # what Open3D makes of a grid without any triangle
        if is_out_of_memory(error):
            raise
        return None
    vertices, faces = surface.vertex.positions.numpy().astype(float), surface.triangle.indices.numpy().astype(np.int64)
    if len(faces) == 0:
        return None
    return sort_mesh(vertices, faces)


def sort_mesh(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Sort vertices by position and faces by their vertices, keeping each face's orientation; equal vertices become one."""
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    first = faces.argmin(axis=1)
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    return Mesh(unique, faces[np.lexsort(faces.T[::-1])])
