"""Demo objects: closed meshes at real size, readable print, BOP's model information."""

import filecmp
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.synthetic.demo_objects import list_demo_objects, write_demo_object
from zeroshop_steps.synthetic.products.printing import encode_ean13

NAMES = list_demo_objects()
IN_EVERY_CHECK = ("gelatin_carton", "bowl")
"""A folded box, whose print is read as well, and a turned body; the others take a second each."""


def each_of(names: Iterable[str]) -> pytest.MarkDecorator:
    """A test of each of these objects, slow for those that not every check makes."""
    return pytest.mark.parametrize("name", [pytest.param(name, marks=[] if name in IN_EVERY_CHECK else pytest.mark.slow) for name in names])


class Models(dict[str, Path]):
    """The folder of each demo object's model, made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __missing__(self, name: str) -> Path:
        write_demo_object(name, self._folder / name)
        self[name] = self._folder / name
        return self[name]


class Meshes(dict[str, Mesh]):
    """Each demo object as it is read back from its PLY."""

    def __init__(self, models: Models) -> None:
        self._models = models

    def __missing__(self, name: str) -> Mesh:
        self[name] = read_ply(self._models[name] / "model.ply")
        return self[name]


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Models:
    """The demo objects' models."""
    return Models(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def meshes(models: Models) -> Meshes:
    """The demo objects' meshes."""
    return Meshes(models)


def _merged(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces with vertices of equal position made one."""
    positions, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return positions, index.reshape(-1)[mesh.faces]


def _uv_area(mesh: Mesh) -> np.ndarray:
    """(F,) signed area of each face in the texture; positive where print is not mirrored."""
    a, b, c = (mesh.uv[mesh.faces[:, corner]] for corner in range(3))
    return ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2


def test_catalogue_holds_the_promised_shapes() -> None:
    assert len(NAMES) >= 10
    assert len(set(NAMES)) == len(NAMES)
    assert {"cracker_carton", "mustard_bottle", "pitcher", "mug", "bowl", "toothpaste_tube", "marker", "clamp"} <= set(NAMES)


@each_of(NAMES)
def test_mesh_is_closed_and_faces_outwards(meshes: Meshes, name: str) -> None:
    positions, faces = _merged(meshes[name])
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward, counts = np.unique(edges, axis=0, return_counts=True)
    assert counts.max() == 1
    np.testing.assert_array_equal(forward, np.unique(edges[:, ::-1], axis=0))
    corners = positions[faces]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    box = np.prod(np.ptp(positions, axis=0))
    assert 0.02 * box < volume < box
    assert 5_000 <= len(faces) <= 42_000


@each_of(NAMES)
def test_size_frame_and_normals(meshes: Meshes, name: str) -> None:
    mesh = meshes[name]
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    np.testing.assert_allclose(low + high, 0, atol=2e-3)
    assert 27 <= high[2] - low[2] <= 220
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)
    corners = mesh.vertices[mesh.faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face_normals, axis=1)
    agreement = np.einsum("ijk,ik->ij", mesh.normals[mesh.faces], face_normals / np.maximum(area, 1e-30)[:, None])
    assert agreement[area > 1e-3].min() > 0.5


@each_of(NAMES)
def test_texture_coordinates_are_inside_and_never_mirrored(meshes: Meshes, name: str) -> None:
    mesh = meshes[name]
    assert mesh.texture.shape == (2048, 2048, 3)
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1
    assert _uv_area(mesh).min() > -1e-9
    corners = mesh.vertices[mesh.faces]
    area_mm2 = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area_mm2[_uv_area(mesh) <= 1e-12].sum() < 0.02 * area_mm2.sum()


@each_of(["cracker_carton", "gelatin_carton", "tomato_can", "mustard_bottle", "toothpaste_tube", "mug"])
def test_print_is_upright_on_walls(meshes: Meshes, name: str) -> None:
    """On the printed front, up in space is up in the texture."""
    mesh = meshes[name]
    normal = mesh.normals[mesh.faces].mean(1)
    middle = mesh.vertices[mesh.faces].mean(1)
    front = mesh.faces[(normal[:, 0] > 0.9) & (middle[:, 0] > 0.25 * np.ptp(mesh.vertices[:, 0]))]
    z, v = mesh.vertices[front, 2], mesh.uv[front, 1]
    rows = np.arange(len(front))
    assert len(front) > 100
    assert (v[rows, z.argmax(1)] - v[rows, z.argmin(1)]).min() > 0


def test_bar_code_on_the_carton_reads_from_left_to_right(meshes: Meshes) -> None:
    """Scan the back of the small carton from outside, bar by bar: geometry, coordinates and print agree."""
    from zeroshop_steps.runtime.open3d_loader import o3d

    mesh = meshes["gelatin_carton"]
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.faces.astype(np.uint32)))
    bars = encode_ean13("207310085144")
    x_on_sheet = 52.0 + (9 + np.arange(95) + 0.5) * 32.0 / 113
    origins = np.column_stack([np.full(95, -100.0), 44.5 - x_on_sheet, np.full(95, 37.0 - 56.0)])
    rays = np.concatenate([origins, np.tile([1.0, 0.0, 0.0], (95, 1))], 1).astype(np.float32)
    hits = scene.cast_rays(o3d.core.Tensor(rays))
    corners = mesh.uv[mesh.faces[hits["primitive_ids"].numpy()]]
    weights = hits["primitive_uvs"].numpy()
    weights = np.column_stack([1 - weights.sum(1), weights])
    uv = np.einsum("ij,ijk->ik", weights, corners)
    size = mesh.texture.shape[0]
    grey = mesh.texture[((1 - uv[:, 1]) * size).astype(int), (uv[:, 0] * size).astype(int)].mean(1)
    assert "".join("1" if value < 128 else "0" for value in grey) == bars


@each_of(["cracker_carton", "gelatin_carton"])
def test_faces_of_the_carton_differ(meshes: Meshes, name: str) -> None:
    mesh = meshes[name]
    means = []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)):
        side = mesh.uv[mesh.normals[:, axis] * sign > 0.99]
        texels = mesh.texture[((1 - side[:, 1]) * 2048).astype(int), (side[:, 0] * 2048).astype(int)]
        means.append(texels.reshape(-1, 3).astype(float).mean(0))
    assert pdist(np.array(means)).min() > 8


def test_bowl_is_concave_thin_and_of_one_colour(meshes: Meshes) -> None:
    mesh = meshes["bowl"]
    assert (mesh.texture == mesh.texture[0, 0]).all()
    height = np.ptp(mesh.vertices[:, 2])
    inner = mesh.vertices[(np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) < 5) & (mesh.normals[:, 2] > 0.9)]
    depth = mesh.vertices[:, 2].max() - inner[:, 2].max()
    assert 0.75 * height < depth < height - 2.5


@each_of(NAMES)
def test_model_info_describes_the_mesh(models: Models, meshes: Meshes, name: str) -> None:
    info = read_json(models[name] / "model_info.json")
    vertices = meshes[name].vertices
    low, size = vertices.min(0), np.ptp(vertices, axis=0)
    np.testing.assert_allclose([info["min_x"], info["min_y"], info["min_z"]], low, atol=1e-3)
    np.testing.assert_allclose([info["size_x"], info["size_y"], info["size_z"]], size, atol=1e-3)
    assert info["name"] == name
    assert info["obj_id"] == NAMES.index(name) + 1
    extreme = [int(np.argmax(vertices @ d)) for d in np.random.default_rng(0).normal(size=(400, 3))]
    assert pdist(vertices[np.unique(extreme)]).max() <= info["diameter"] + 1e-3
    assert size.max() <= info["diameter"] <= np.linalg.norm(size) + 1e-3
    assert ("symmetries_continuous" in info) == (name == "bowl")


def test_bowl_turns_about_z(models: Models) -> None:
    assert read_json(models["bowl"] / "model_info.json")["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]


@pytest.mark.slow
@each_of(["mustard_bottle", "tuna_can", "clamp"])
def test_same_bytes_twice(models: Models, tmp_path: Path, name: str) -> None:
    write_demo_object(name, tmp_path)
    for file in ("model.ply", "model.png", "model_info.json"):
        assert filecmp.cmp(tmp_path / file, models[name] / file, shallow=False), file


def test_bar_code_follows_the_standard() -> None:
    bars = encode_ean13("590123412345")
    assert len(bars) == 95
    assert bars.startswith("101" + "0001011" + "0100111")
    assert bars.endswith("1000100" + "101")  # check digit 7


def test_unknown_object_is_named_with_those_that_exist(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="teapot.*cracker_carton.*clamp"):
        write_demo_object("teapot", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_command_writes_a_model(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "zeroshop_steps.synthetic",
        "--method",
        "demo_objects",
        "--object",
        "bowl",
        "--out",
        str(tmp_path / "model"),
    ]
    subprocess.run(command, check=True, capture_output=True)
    assert sorted(path.name for path in (tmp_path / "model").iterdir()) == ["model.ply", "model.png", "model_info.json"]
    assert json.loads((tmp_path / "model" / "model_info.json").read_text())["name"] == "bowl"
    failed = subprocess.run([*command[:6], "teapot", *command[7:]], capture_output=True, text=True)
    assert failed.returncode != 0
    assert "error: there is no demo object 'teapot'" in failed.stderr
    assert "Traceback" not in failed.stderr
