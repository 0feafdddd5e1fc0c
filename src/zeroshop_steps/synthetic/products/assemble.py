"""From solids and panels to one closed, textured mesh about the origin."""

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from zeroshop_steps.geometry.meshes.mesh_repair import find_triangles
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.synthetic.products.panels import Panel, map_to_texture, pack_panels, print_texture
from zeroshop_steps.synthetic.products.solids import Solid

TEXTURE_PX = 2048
GRID_MM = 1e-4
CREASE_DEG = 40.0


@dataclass(frozen=True)
class Product:
    """What a product is made of.

    Attributes:
        solids: closed bodies whose union is the product.
        panels: all surfaces that the solids' patches name.
        turns_about_z: whether it looks the same from all sides, print included.
    """

    solids: Sequence[Solid]
    panels: Sequence[Panel]
    turns_about_z: bool = False


def make_textured_mesh(product: Product, texture_px: int = TEXTURE_PX) -> Mesh:
    """Join the solids, print their texture, centre the bounding box at the origin; vertices in mm."""
    places, px_per_mm = pack_panels(product.panels, texture_px)
    panels = {panel.name: panel for panel in product.panels}
    parts = []
    for solid in product.solids:
        vertices = np.concatenate([patch.vertices for patch in solid])
        starts = np.cumsum([0] + [len(patch.vertices) for patch in solid])
        faces = np.concatenate([patch.faces + start for patch, start in zip(solid, starts[:-1], strict=True)])
        uvs = [map_to_texture(patch.uv_mm, panels[patch.panel], places[patch.panel], texture_px) for patch in solid]
        parts.append((_round_to_grid(vertices), faces, np.concatenate(uvs)))
    vertices, faces, uv = parts[0] if len(parts) == 1 else _unite(parts)
    vertices = vertices - (vertices.min(0) + vertices.max(0)) / 2
    vertices, faces, uv = _drop_slivers(_round_to_grid(vertices), faces, uv)
    vertices, faces, uv, normals = _split_at_creases(vertices, faces, uv)
    mesh = Mesh(vertices, faces, normals, uv, print_texture(product.panels, places, px_per_mm, texture_px))
    _check_closed(mesh)
    return mesh


def make_model_info(mesh: Mesh, product: Product, name: str, obj_id: int) -> dict:
    """The object's entry of BOP's models_info: lengths in mm; diameter is the largest distance between two vertices.

    Symmetries count print as well as shape, as BOP does, so only unprinted products have one.
    """
    low = mesh.vertices.min(0)
    size = mesh.vertices.max(0) - low
    hull = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    info = {"obj_id": obj_id, "name": name, "diameter": round(float(pdist(hull).max()), 6)}
    info |= {f"min_{axis}": round(float(value), 6) for axis, value in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": round(float(value), 6) for axis, value in zip("xyz", size, strict=True)}
    if product.turns_about_z:
        info["symmetries_continuous"] = [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]
    return info


def _round_to_grid(vertices: np.ndarray) -> np.ndarray:
    """Rounded, so that positions which are equal up to arithmetic become equal."""
    return np.round(vertices / GRID_MM) * GRID_MM + 0.0


def _unite(parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The union of closed bodies (vertices, faces, uv); texture coordinates are interpolated along the new edges."""
    whole = manifold3d.Manifold()
    for vertices, faces, uv in parts:
        columns = np.concatenate([vertices, uv], 1)
        _, first, position = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
        merge_to = first[position.reshape(-1)]
        repeated = np.nonzero(merge_to != np.arange(len(vertices)))[0]
        body = manifold3d.Manifold(
            manifold3d.Mesh64(
                columns,
                faces.astype(np.uint64),
                merge_from_vert=repeated.astype(np.uint64),
                merge_to_vert=merge_to[repeated].astype(np.uint64),
            )
        )
        if body.status() != manifold3d.Error.NoError:
            raise ValueError(f"a body of the product is not closed: {body.status()}")
        whole = whole + body
    joined = whole.to_mesh64()
    columns = np.asarray(joined.vert_properties)
    return columns[:, :3], np.asarray(joined.tri_verts).astype(np.int64), columns[:, 3:5]


def _drop_slivers(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drop faces that the rounding closed up, and vertices that no face uses."""
    _, position = np.unique(vertices, axis=0, return_inverse=True)
    corner = position.reshape(-1)[faces]
    faces = faces[find_triangles(corner)]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3), uv[used]


def _split_at_creases(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Area-weighted vertex normals that are smooth over edges flatter than CREASE_DEG; vertices on sharper ones are doubled."""
    corners = vertices[faces]
    area_normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = area_normal / np.maximum(np.linalg.norm(area_normal, axis=1, keepdims=True), 1e-30)
    _, position = np.unique(vertices, axis=0, return_inverse=True)
    corner_position = position.reshape(-1)[faces].reshape(-1)
    corner_face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corner_position, kind="stable")
    starts = np.searchsorted(corner_position[order], np.arange(corner_position.max() + 2))
    counts = np.diff(starts)
    normals = np.zeros((len(corner_face), 3))
    for shift in range(int(counts.max())):
        count = counts[corner_position]
        valid = shift < count
        other = corner_face[order[starts[corner_position[valid]] + shift]]
        alike = np.einsum("ij,ij->i", unit[other], unit[corner_face[valid]]) > np.cos(np.deg2rad(CREASE_DEG))
        normals[valid] += area_normal[other] * alike[:, None]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    key = np.column_stack([faces.reshape(-1), np.round(normals, 4)])
    _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    source = faces.reshape(-1)[first]
    return vertices[source], index.reshape(-1, 3), uv[source], normals[first]


def _check_closed(mesh: Mesh) -> None:
    _, position = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corner = position.reshape(-1)[mesh.faces]
    edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    forward, counts = np.unique(edges, axis=0, return_counts=True)
    backward = np.unique(edges[:, ::-1], axis=0)
    if counts.max() > 1 or len(forward) != len(backward) or (forward != backward).any():
        raise ValueError("the product's surface is not closed or not consistently oriented")
