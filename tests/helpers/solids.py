"""Meshes as trimesh has them, which knows volumes and whether a surface is closed."""

import trimesh

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    """The geometry alone; vertices are not merged."""
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
