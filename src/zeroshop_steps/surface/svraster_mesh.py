"""Extract a raw mesh from trained voxels: their depth maps are fused into signed distances (TSDF; Curless & Levoy 1996) on the lattice
of the finest leaves, and marching cubes (Lorensen & Cline 1987) takes the surface.

Depth maps of one view are rough: colour says nothing about ripples as fine as a voxel. Their mean over the views is not. What no camera
sees counts as inside, so that the shell that training leaves of an object becomes one surface, not two. A small offset brings the
silhouettes onto the masks, and surface that too few cameras see is left out.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.meshes.mesh_repair import label_parts
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visibility import GRAZING_COSINE
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.meshing.raw_mesh import OFFSET_VOXELS, read_mesh_views, sort_mesh, write_raw_mesh
from zeroshop_steps.surface.meshing.silhouette_offset import fit_to_masks
from zeroshop_steps.surface.mvs.depth_maps import look_up_depths
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.render import RenderView, render
from zeroshop_steps.surface.svraster.signed_distances import Lattice, fuse_signed_distances
from zeroshop_steps.surface.svraster.voxels import Voxels, read_voxels

# The bounds below were chosen on two demo objects trained for 5,000 iterations and three trained from stereo. A step is the distance of two
# points of the lattice.
REACH_STEPS = 6.0
"""Depth maps are averaged within this many steps around the surface that they show."""
SMOOTH_STEPS = 1.0
"""Standard deviation, in steps, by which distances are smoothed."""
SEEN_STEPS = 2.0
"""A vertex within this many steps of the surface that a view shows is seen by the view."""
GAP_RADII = 0.125
"""Unseen surface of at most the area of a square of this width, in radii of the object, is kept: the floor of a pit, say, which few
views show."""

UNKNOWN = np.float32(-1.0)
"""Depth where light passes through voxels that the mask says are there: the object is somewhere on that ray."""


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
    lattice = Lattice.around(voxels.octree, border=2)
    depths = [render_depth(voxels, view) for view in views]
    mesh = extract_surface(lattice, views, depths)
    if mesh is None:
        raise StepError(f"{args.model} has no surface; train longer or check masks and cameras")
    mesh, offset = fit_to_masks(mesh, views, limit=OFFSET_VOXELS * lattice.step)
    mesh = keep_seen(mesh, views, depths, lattice.step)
    if len(mesh.faces) == 0:
        raise StepError(f"{args.model} has no surface that {AGREEING_VIEWS} views see; train longer or check masks and cameras")
    write_raw_mesh(args.out, mesh, sphere, len(voxels), offset / lattice.step, start_s)


def render_depth(voxels: Voxels, view: TrainingView) -> np.ndarray:
    """(H, W) float32 depth at which half of the light of each pixel is stopped; `UNKNOWN` where less is, and 0 outside the mask."""
    with torch.no_grad():
        rendering = render(voxels.octree, voxels.densities, torch.zeros(len(voxels), 1, 3), 0, RenderView.from_training_view(view))
    depth = rendering.median_depth.numpy()
    return np.where(view.mask.numpy() > 0.5, np.where(depth > 0, depth, UNKNOWN), np.float32(0.0))


def extract_surface(lattice: Lattice, views: list[TrainingView], depths: list[np.ndarray]) -> Mesh | None:
    """The surface that depth maps agree on, in normalized coordinates; None when there is none.

    Args:
        depths: for each view, (H, W) depth of the surface, 0 where the view sees past the object, negative where it is unknown.
    """
    cameras, reach = [view.camera for view in views], REACH_STEPS * lattice.step
    inwards = np.empty(lattice.shape, np.float32)
    for number, layer in enumerate(inwards):
        distances = fuse_signed_distances(lattice.layer(number), cameras, depths, reach, zero_is_free=True, min_views=AGREEING_VIEWS)
        layer[:] = -distances.reshape(layer.shape)
    inwards = gaussian_filter(inwards, SMOOTH_STEPS)
    inwards[[0, -1]] = inwards[:, [0, -1]] = inwards[:, :, [0, -1]] = -reach
    mesh = extract_level_set(inwards)
    return mesh and Mesh(lattice.points(mesh.vertices), mesh.faces)


def keep_seen(mesh: Mesh, views: list[TrainingView], depths: list[np.ndarray], step: float) -> Mesh:
    """The faces that lie on the surface that enough views show, and that face some camera, and small gaps between them.

    The rest is a guess, for example the underside, and the walls of a hollow that no camera looks into.

    Args:
        depths: for each view, (H, W) depth of the surface, 0 where the view sees past the object, negative where it is unknown.
        step: of the lattice.
    """
    normals, corners = mesh.face_normals(), mesh.vertices[mesh.faces[:, 0]]
    cosine, shown = np.full(len(normals), -1.0), np.zeros(len(mesh.vertices), int)
    for view, depth in zip(views, depths, strict=True):
        towards = view.camera.centre_in_world - corners
        np.maximum(cosine, np.einsum("fi,fi->f", normals, towards) / np.linalg.norm(towards, axis=1), out=cosine)
        framed, surface, own = look_up_depths(view.camera, depth, mesh.vertices)
        shown[framed] += np.abs(surface - own) < SEEN_STEPS * step
    kept = (cosine > GRAZING_COSINE) & (shown[mesh.faces] >= AGREEING_VIEWS).all(axis=1)
    gap = label_parts(mesh.faces[~kept])
    kept[~kept] = np.bincount(gap, mesh.face_areas()[~kept])[gap] < GAP_RADII**2
    return Mesh(mesh.vertices, mesh.faces[kept]).without_loose_vertices()


def extract_level_set(values: np.ndarray) -> Mesh | None:
    """The surface where (X, Y, Z) float32 values pass zero, facing the negative side; None when there is none.

    Vertices are in units of the lattice.
    """
    if values.min() > 0 or values.max() < 0:
        return None
    vertices, faces, _, _ = marching_cubes(-values, 0.0)
    return sort_mesh(vertices.astype(float), faces.astype(np.int64))
