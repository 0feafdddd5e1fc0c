"""Reduce a mesh for a web page: fewer faces, with its texture or, if it is very large, with vertex colours."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.meshes.mesh_repair import drop_repeated_faces, find_triangles
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import sample_texture

# Above this many faces texture coordinates are not carried through the decimation, which would take minutes and gigabytes.
TEXTURED_FACES = 400_000
GRID = 320  # cells along the longest side, in which the vertices of a larger mesh are merged
COLLAPSE = {
    "qualitythr": 0.3,
    "preserveboundary": False,
    "boundaryweight": 1.0,
    "optimalplacement": True,
    "preservenormal": True,
    "planarquadric": False,
}
"""All options, always: MeshLab would take missing ones from its last call in the same process."""


@dataclass(frozen=True)
class ReducedMesh:
    """A mesh for the viewer.

    Attributes:
        mesh: few enough faces for the page; normals are there, `uv` and `texture` where the texture was kept.
        colors: (V, 3) uint8 RGB, where there is no texture; None where the mesh has no colour at all.
        faces: how many faces the mesh had.
    """

    mesh: Mesh
    colors: np.ndarray | None
    faces: int


def reduce_mesh(mesh: Mesh, max_faces: int, texture_px: int) -> ReducedMesh:
    """The mesh with at most about `max_faces` faces and a texture of at most `texture_px` pixels.

    Quadric edge collapse (Garland and Heckbert, SIGGRAPH 1997) over the welded surface, so that no seam of the atlas tears open.
    """
    if len(mesh.faces) > TEXTURED_FACES:
        small = _collapse_edges(_cluster_vertices(mesh), max_faces)[0]
        return ReducedMesh(small.with_normals(), _sample_colors(mesh, small.vertices), len(mesh.faces))
    small, corner_uv = _collapse_edges(mesh, max_faces) if len(mesh.faces) > max_faces else _weld(mesh)
    small = small.with_normals()
    if corner_uv is None or mesh.texture is None:
        return ReducedMesh(small, _sample_colors(mesh, small.vertices), len(mesh.faces))
    return ReducedMesh(_split_at_seams(small, corner_uv, _shrink_texture(mesh.texture, texture_px)), None, len(mesh.faces))


def _weld(mesh: Mesh) -> tuple[Mesh, np.ndarray | None]:
    """The mesh with vertices at the same position joined, and (F, 3, 2) texture coordinates of the faces' corners."""
    vertices, index = np.unique(mesh.vertices.astype(np.float32), axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    sound = find_triangles(faces)
    uv = mesh.uv[mesh.faces[sound]] if mesh.uv is not None else None
    return Mesh(vertices.astype(float), faces[sound]), uv


def _cluster_vertices(mesh: Mesh) -> Mesh:
    """The mesh with the vertices in each cell of a grid joined (Rossignac and Borrel 1993): fast, and finer than the page shows."""
    low = mesh.vertices.min(0)
    size = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-9) / GRID
    cells, index = np.unique(np.floor((mesh.vertices - low) / size).astype(np.int64) @ (1, GRID + 2, (GRID + 2) ** 2), return_inverse=True)
    count = np.bincount(index, minlength=len(cells))[:, None]
    means = np.stack([np.bincount(index, mesh.vertices[:, axis], len(cells)) for axis in range(3)], 1) / count
    faces = index[mesh.faces]
    return Mesh(means, drop_repeated_faces(faces[find_triangles(faces)])).without_loose_vertices()


def _collapse_edges(mesh: Mesh, max_faces: int) -> tuple[Mesh, np.ndarray | None]:
    import pymeshlab

    work = pymeshlab.MeshSet(verbose=False)
    textured = {} if mesh.uv is None else {"v_tex_coords_matrix": mesh.uv}
    work.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces.astype(np.int32), **textured))
    if textured:
        work.compute_texcoord_transfer_vertex_to_wedge()
    work.meshing_merge_close_vertices(threshold=pymeshlab.PureValue(0))
    if textured:
        work.meshing_decimation_quadric_edge_collapse_with_texture(targetfacenum=max_faces, extratcoordw=1.0, **COLLAPSE)
    else:
        work.meshing_decimation_quadric_edge_collapse(targetfacenum=max_faces, autoclean=True, **COLLAPSE)
    work.meshing_remove_unreferenced_vertices()
    result = work.current_mesh()
    small = Mesh(result.vertex_matrix(), result.face_matrix().astype(np.int64))
    return small, result.wedge_tex_coord_matrix().reshape(-1, 3, 2) if textured else None


def _split_at_seams(mesh: Mesh, corner_uv: np.ndarray, texture: np.ndarray) -> Mesh:
    """The mesh with one vertex for each position and texture coordinate."""
    corners = np.concatenate([mesh.faces.reshape(-1, 1), np.rint(corner_uv.reshape(-1, 2) * 65535)], 1).astype(np.int64)
    rows, index = np.unique(corners, axis=0, return_inverse=True)
    place = rows[:, 0]
    return Mesh(mesh.vertices[place], index.reshape(-1, 3), mesh.vertex_normals[place], rows[:, 1:] / 65535.0, texture)


def _sample_colors(mesh: Mesh, points: np.ndarray) -> np.ndarray | None:
    """(N, 3) uint8 colours of the texture, or else of the mesh itself, at the vertices nearest to `points`; None where there are none."""
    if not mesh.is_colored:
        return None
    nearest = cKDTree(mesh.vertices).query(points)[1]
    if mesh.uv is None or mesh.texture is None:
        return None if mesh.colors is None else mesh.colors[nearest]
    return np.clip(np.rint(sample_texture(mesh.texture, mesh.uv[nearest])), 0, 255).astype(np.uint8)


def _shrink_texture(texture: np.ndarray, texture_px: int) -> np.ndarray:
    scale = min(1.0, texture_px / max(texture.shape[:2]))
    size = (max(1, round(texture.shape[1] * scale)), max(1, round(texture.shape[0] * scale)))
    return texture if scale == 1.0 else cv2.resize(texture, size, interpolation=cv2.INTER_AREA)
