"""A small textured box whose front tells left from right and top from bottom."""

from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import write_json

BOX_SIZE_MM = np.array([40.0, 60.0, 100.0])


def box_mesh() -> Mesh:
    """A closed box in mm, standing on z = -50; all six faces show the whole texture upright, seen from outside."""
    vertices, faces, normals, uv = [], [], [], []
    for normal, right in (
        ((1, 0, 0), (0, 1, 0)),
        ((-1, 0, 0), (0, -1, 0)),
        ((0, 1, 0), (-1, 0, 0)),
        ((0, -1, 0), (1, 0, 0)),
        ((0, 0, 1), (0, 1, 0)),
        ((0, 0, -1), (0, 1, 0)),
    ):
        n, r = np.array(normal, float), np.array(right, float)
        up = np.cross(n, r)
        first = len(vertices)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            vertices.append((n + a * r + b * up) * BOX_SIZE_MM / 2)
            normals.append(n)
            uv.append(((a + 1) / 2, (b + 1) / 2))
        faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return Mesh(np.array(vertices), np.array(faces), np.array(normals), np.array(uv), box_texture())


def box_texture() -> np.ndarray:
    """Left half red, right half green, the top quarter white."""
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:, :32] = 200, 20, 20
    texture[:, 32:] = 20, 160, 20
    texture[:16] = 220
    return texture


def write_box(folder: Path, name: str = "model") -> Path:
    """Write the box as PLY, texture and, for the name `model`, its information."""
    mesh = box_mesh()
    write_image(folder / f"{name}.png", mesh.texture)
    write_ply(folder / f"{name}.ply", mesh, f"{name}.png")
    if name == "model":
        write_json(folder / "model_info.json", {"name": "box", "obj_id": 1})
    return folder / f"{name}.ply"
