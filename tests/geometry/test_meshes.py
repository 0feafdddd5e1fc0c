"""Meshes: what is written reads back, by other readers too, and a damaged file is named."""

from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.errors import StepError


def square(texture: bool = True) -> Mesh:
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [10, 20, 0], [0, 20, 0]])
    uv = vertices[:, :2] / [10, 20] if texture else None
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), uv=uv).with_normals()


@pytest.mark.parametrize("change", ["loose vertex", "coinciding vertices"])
def test_texture_coordinates_stay_with_their_vertices(tmp_path: Path, change: str) -> None:
    first, extra = ("9 9 9", "9 9 9") if change == "loose vertex" else ("0 0 0", "0 0 0")
    corners = ["0 0 0 0.1 0.1", "10 0 0 0.9 0.1", "10 20 0 0.9 0.8", "0 20 0 0.1 0.8"]
    properties = [f"property float {name}" for name in ("x", "y", "z", "texture_u", "texture_v")]
    header = ["ply", "format ascii 1.0", "element vertex 6", *properties, "element face 2", "property list uchar int vertex_indices"]
    lines = [*header, "end_header", f"{first} 0.4 0.4", *corners, f"{extra} 0.2 0.2", "3 1 2 3", "3 1 3 4"]
    (tmp_path / "other.ply").write_text("\n".join(lines) + "\n")
    mesh = read_ply(tmp_path / "other.ply")
    assert np.allclose(mesh.uv[mesh.faces], np.where(mesh.vertices[mesh.faces][..., :2] > [5, 5], [0.9, 0.8], 0.1))


def test_a_mesh_survives_the_disk_and_other_readers(tmp_path: Path) -> None:
    import trimesh

    mesh = square()
    write_image(tmp_path / "t.png", np.full((4, 4, 3), 200, np.uint8))
    write_ply(tmp_path / "m.ply", mesh, "t.png")
    back = read_ply(tmp_path / "m.ply")
    assert np.array_equal(back.vertices, mesh.vertices) and np.array_equal(back.faces, mesh.faces)
    assert np.allclose(back.uv, mesh.uv) and np.allclose(back.normals, [[0, 0, 1]] * 4) and back.texture.shape == (4, 4, 3)
    assert len(trimesh.load(tmp_path / "m.ply", process=False).vertices) == 4


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_other_layouts_of_ply_read_alike(tmp_path: Path, encoding: str) -> None:
    import trimesh

    mesh = square(texture=False)
    write_ply(tmp_path / "ours.ply", mesh)
    other = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=np.full((4, 4), 90, np.uint8), process=False)
    (tmp_path / "other.ply").write_bytes(trimesh.exchange.ply.export_ply(other, encoding=encoding))
    ours, theirs = read_ply(tmp_path / "ours.ply"), read_ply(tmp_path / "other.ply")
    assert np.array_equal(ours.vertices, theirs.vertices) and np.array_equal(ours.faces, theirs.faces)


@pytest.mark.parametrize("damage", ["truncated", "text", "empty", "faces"])
def test_a_corrupted_ply_is_named(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "bad.ply"
    mesh = square(texture=False)
    write_ply(path, Mesh(mesh.vertices, mesh.faces + 7) if damage == "faces" else mesh)
    content = path.read_bytes()
    if damage != "faces":
        path.write_bytes({"truncated": content[:-9], "text": b"hello", "empty": b""}[damage])
    with pytest.raises(StepError, match="bad.ply"):
        read_ply(path)
