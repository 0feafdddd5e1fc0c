"""Raw meshes: what the ways of taking one from a trained model have in common."""

import time
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.meshes.mesh_repair import find_triangles
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import is_out_of_memory
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.runtime.open3d_loader import o3d
from zeroshop_steps.surface.rendering.training_views import TrainingView, make_training_views, read_camera_set

OFFSET_VOXELS = 2.0
"""The surface is moved by at most this to bring its silhouettes onto the masks (`silhouettes.fit_to_masks`). Soft surfels put the
whole surface about half a voxel inside; more than two voxels would be another fault."""


def read_mesh_views(cameras: Path, sphere: ObjectSphere, image_width_px: int) -> list[TrainingView]:
    """The views of a registration in which depth maps are rendered for the mesh."""
    return make_training_views(read_camera_set(cameras), sphere, image_width_px, border_px=1)


def make_tsdf_grid(voxel: float, blocks: int) -> o3d.t.geometry.VoxelBlockGrid:
    """An empty grid of truncated signed distances; voxel: its edge; blocks: for how many there is room at first."""
    attributes = (o3d.core.float32, o3d.core.float32)
    return o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight"), attributes, ((1), (1)), voxel, block_count=blocks)


def extract_mesh(grid: o3d.t.geometry.VoxelBlockGrid, weight_min: float) -> Mesh | None:
    """The zero level set where weights exceed `weight_min`, by marching cubes; None when there is none."""
    try:
        surface = grid.extract_triangle_mesh(weight_threshold=weight_min)
    except RuntimeError as error:  # Open3D's error for a grid without any triangle
        if is_out_of_memory(error):
            raise
        return None
    vertices, faces = surface.vertex.positions.numpy().astype(float), surface.triangle.indices.numpy().astype(np.int64)
    return sort_mesh(vertices, faces) if len(faces) else None


def sort_mesh(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Sort vertices by position and faces by their vertices, keeping each face's orientation; equal vertices become one.

    Open3D's hash map returns its blocks in no fixed order. Sorted, the same surface gives the same bytes.
    """
    unique, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    first = faces.argmin(axis=1)
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    faces = faces[find_triangles(faces)]
    return Mesh(unique, faces[np.lexsort(faces.T[::-1])])


def write_raw_mesh(path: Path, mesh: Mesh, sphere: ObjectSphere, voxels: int, offset_voxels: float, start_s: float) -> None:
    """Write a mesh in normalized coordinates as PLY in the registration's frame, and its figures as JSON beside it.

    Args:
        voxels: how many there are, in the method's own sense.
        offset_voxels: by how much the surface was moved onto the masks.
        start_s: `time.monotonic` when the step began.
    """
    world = Mesh(mesh.vertices * sphere.radius + sphere.centre, mesh.faces)
    write_ply(path, world)
    figures = {
        "seconds": round(time.monotonic() - start_s, 2),
        "vertices": len(world.vertices),
        "faces": len(world.faces),
        "voxels": voxels,
        "offset_voxels": round(offset_voxels, 3),
    }
    write_json(path.with_suffix(".json"), figures)
