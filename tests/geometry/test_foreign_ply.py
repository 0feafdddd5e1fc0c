"""PLY as other programs write it: texture coordinates and colours of every form, polygons, byte orders; untrusted names."""

import struct
from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.mesh_files import read_mesh
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import sample_texture
from zeroshop_steps.runtime.errors import StepError

CORNERS = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 20.0, 0.0], [0.0, 20.0, 0.0]]
UV = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
RED, GREEN = (200, 10, 20), (30, 220, 40)
XYZ = "float x,float y,float z"
TRIANGLES: list[list] = [[[0, 1, 2]], [[0, 2, 3]]]
INDICES = "list uchar int vertex_indices"
CODES = {
    "float": "f",
    "float32": "f",
    "double": "d",
    "float64": "d",
    "char": "b",
    "uchar": "B",
    "uint8": "B",
    "ushort": "H",
    "int": "i",
    "uint32": "I",
}
FORMS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
REPORTS = Path(__file__).parents[3] / "shared/data/reports/ply"


def write(
    folder: Path,
    vertices: list[list],
    of_vertex: str = XYZ,
    faces: list[list] = TRIANGLES,
    of_face: str = INDICES,
    form: str = "ascii",
    remarks: tuple[str, ...] = (),
    line_end: str = "\n",
) -> Path:
    """A PLY whose rows hold a value for each property, and a list for each list property."""
    header, body = ["ply", f"format {form} 1.0", *remarks], b""
    for name, properties, rows in (("vertex", of_vertex, vertices), ("face", of_face, faces)):
        kinds = [kind.split() for kind in properties.split(",")]
        header += [f"element {name} {len(rows)}", *(f"property {' '.join(kind)}" for kind in kinds)]
        for row in rows:
            words = []
            for kind, value in zip(kinds, row, strict=True):
                values = [(kind[1], len(value)), *((kind[2], one) for one in value)] if kind[0] == "list" else [(kind[0], value)]
                words += [str(one) if form == "ascii" else struct.pack(FORMS[form] + CODES[code], one) for code, one in values]
            body += (" ".join(words) + line_end).encode() if form == "ascii" else b"".join(words)
    path = folder / "mesh.ply"
    path.write_bytes(line_end.join([*header, "end_header", ""]).encode() + body)
    return path


def add_texture(folder: Path, name: str = "tex.png", shift: int = 0) -> np.ndarray:
    """An image whose four quarters differ."""
    quarters = np.array([[[250, 0, 0], [0, 250, 0]], [[0, 0, 250], [250, 250, 0]]], np.uint8) - np.uint8(shift)
    image = quarters.repeat(8, 0).repeat(8, 1)
    write_image(folder / name, image)
    return image


def colors_at(mesh: Mesh, weights: tuple[float, float, float]) -> np.ndarray:
    """(F, 3) colours of the faces at these weights of their corners."""
    textured = with_texture(mesh)
    uv = np.einsum("c,fcd->fd", weights, textured.texture_coordinates[textured.faces])
    return np.rint(sample_texture(textured.texture_image, uv))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("names", [("texture_u", "texture_v"), ("s", "t"), ("u", "v")])
def test_texture_coordinates_of_vertices_have_many_names(tmp_path: Path, form: str, names: tuple[str, str]) -> None:
    add_texture(tmp_path)
    rows = [[*corner, *uv] for corner, uv in zip(CORNERS, UV, strict=True)]
    mesh = read_ply(write(tmp_path, rows, f"{XYZ},float {names[0]},float {names[1]}", form=form, remarks=("comment TextureFile tex.png",)))
    assert np.allclose(mesh.uv, UV) and mesh.texture is not None and len(mesh.vertices) == 4


@pytest.mark.parametrize("form", FORMS)
def test_texture_coordinates_of_corners_split_vertices(tmp_path: Path, form: str) -> None:
    """A quad and a triangle share an edge; the triangle lies elsewhere in the texture, as MeshLab and OpenMVS write it."""
    add_texture(tmp_path)
    corners = [*CORNERS, [5.0, 30.0, 0.0]]
    faces = [[[0, 1, 2, 3], np.ravel(UV).tolist()], [[3, 2, 4], [0.1, 0.2, 0.3, 0.2, 0.2, 0.4]]]
    remarks = ("comment VCGLIB generated", "comment TextureFile tex.png")
    mesh = read_ply(write(tmp_path, corners, XYZ, faces, "list uint8 uint32 vertex_indices,list uchar float texcoord", form, remarks))
    assert len(mesh.faces) == 3 and len(mesh.vertices) == 7, "two of five vertices are at a seam"
    last = mesh.faces[2]
    assert np.allclose(mesh.uv[last], [[0.1, 0.2], [0.3, 0.2], [0.2, 0.4]]) and np.allclose(
        mesh.vertices[last], [corners[3], corners[2], corners[4]]
    )
    assert np.allclose(mesh.uv[mesh.faces[:2]] * [10, 20], mesh.vertices[mesh.faces[:2]][..., :2]) and mesh.is_textured


def test_several_textures_become_one(tmp_path: Path) -> None:
    images = [add_texture(tmp_path, "a.png"), add_texture(tmp_path, "b.png", 100)]
    faces = [[[0, 1, 2], [0.1, 0.1, 0.4, 0.1, 0.4, 0.4], 1], [[0, 2, 3], [1.6, 0.6, 1.9, 0.9, 1.6, 0.9], 0], [[3, 2, 1], [0.0] * 6, -1]]
    path = write(
        tmp_path,
        [[*corner, *RED] for corner in CORNERS],
        f"{XYZ},uchar red,uchar green,uchar blue",
        faces,
        f"{INDICES},list uchar float texcoord,int texnumber",
        remarks=("comment TextureFile a.png", "comment TextureFile b.png"),
    )
    found = {tuple(color) for color in colors_at(read_ply(path), (0.4, 0.3, 0.3)).astype(int).tolist()}
    assert found == {tuple(images[1][12, 4].tolist()), tuple(images[0][4, 12].tolist()), RED}
    path.write_bytes(path.read_bytes().replace(b"comment TextureFile b.png\n", b""))
    with pytest.raises(StepError, match=r"mesh\.ply has faces of texture 1, but names 1 textures"):
        read_ply(path)


@pytest.mark.parametrize(
    ("properties", "values"),
    [
        ("uchar red,uchar green,uchar blue,uchar alpha", [*RED, 255]),
        ("uchar diffuse_red,uchar diffuse_green,uchar diffuse_blue", RED),
        ("uchar ambient_red,uchar ambient_green,uchar ambient_blue", RED),
        ("float red,float green,float blue", [value / 255 for value in RED]),
        ("float red,float green,float blue", [float(value) for value in RED]),
        ("ushort red,ushort green,ushort blue", [value * 257 for value in RED]),
        ("ushort red,ushort green,ushort blue", RED),
        ("uchar r,uchar g,uchar b", RED),
        ("uchar Red,uchar Green,uchar Blue", RED),
    ],
)
def test_colours_of_vertices(tmp_path: Path, properties: str, values: list) -> None:
    for form in FORMS:
        mesh = read_ply(write(tmp_path, [[*corner, *values] for corner in CORNERS], f"{XYZ},{properties}", form=form))
        assert mesh.colors is not None and (mesh.colors == RED).all()
        assert (colors_at(mesh, (0.5, 0.25, 0.25)) == RED).all()


def test_bytes_that_are_declared_signed_are_bright_colours(tmp_path: Path) -> None:
    signed = [value - 256 if value > 127 else value for value in RED]
    mesh = read_ply(write(tmp_path, [[*corner, *signed] for corner in CORNERS], f"{XYZ},char red,char green,char blue"))
    assert (mesh.colors == RED).all()


@pytest.mark.parametrize("kind", ["float64", "double"])
def test_texture_coordinates_of_corners_are_whole_or_refused(tmp_path: Path, kind: str) -> None:
    add_texture(tmp_path)
    faces = [[[0, 1, 2], [0.0, 0.0, 1.0, 0.0, 1.0, 1.0]], [[0, 2, 3], []]]
    properties, remarks = f"{INDICES},list uchar {kind} texcoord", ("comment TextureFile tex.png",)
    mesh = read_ply(write(tmp_path, CORNERS, XYZ, faces, properties, "binary_big_endian", remarks))
    assert np.allclose(mesh.uv[mesh.faces], [[[0, 0], [1, 0], [1, 1]], [[0, 0]] * 3])
    faces[1][1] = [0.0, 0.0, 1.0, 0.0]
    with pytest.raises(StepError, match="face 1 has 3 corners and 4 numbers in texcoord; expected 6"):
        read_ply(write(tmp_path, CORNERS, XYZ, faces, properties, "binary_big_endian", remarks))


def test_colours_of_faces_split_vertices(tmp_path: Path) -> None:
    faces = [[[0, 1, 2], *RED], [[0, 2, 3], *GREEN]]
    mesh = read_ply(write(tmp_path, CORNERS, XYZ, faces, f"{INDICES},uchar red,uchar green,uchar blue"))
    assert (mesh.colors[mesh.faces[0]] == RED).all() and (mesh.colors[mesh.faces[1]] == GREEN).all() and len(mesh.vertices) == 6


def test_a_texture_of_vertex_colours_interpolates_them() -> None:
    colors = np.array([[0, 0, 0], [100, 0, 50], [0, 200, 50], [50, 50, 50]], np.uint8)
    mesh = Mesh(np.array(CORNERS), np.array([[0, 1, 2], [0, 2, 3]]), colors=colors)
    weights = (0.2, 0.5, 0.3)
    assert np.abs(colors_at(mesh, weights) - np.einsum("c,fcd->fd", weights, colors[mesh.faces])).max() <= 1
    plain = colors_at(Mesh(mesh.vertices, mesh.faces), weights)
    assert (plain == plain[0, 0]).all() and 100 < plain[0, 0] < 255


CONCAVE = {
    "arrow": [(0, 0), (10, 8), (0, 16), (4, 8)],
    "arrow, from its tip": [(10, 8), (0, 16), (4, 8), (0, 0)],
    "plus": [(3, 0), (6, 0), (6, 3), (9, 3), (9, 6), (6, 6), (6, 9), (3, 9), (3, 6), (0, 6), (0, 3), (3, 3)],
    "comb": [(0, 0), (50, 0), (50, 20), (40, 20), (40, 5), (30, 5), (30, 20), (20, 20), (20, 5), (10, 5), (10, 20), (0, 20)],
}


@pytest.mark.parametrize("kind", CONCAVE)
@pytest.mark.parametrize("name", ["mesh.ply", "mesh.obj"])
def test_concave_polygons_are_covered_once(tmp_path: Path, name: str, kind: str) -> None:
    """Convex ones beside them keep their fans, and texture coordinates stay at their corners."""
    add_texture(tmp_path)
    flat = np.array([*CONCAVE[kind], (60, 0), (70, 0), (70, 9), (60, 9)], float)
    corners = np.stack([flat[:, 0], np.full(len(flat), 7.0), flat[:, 1]], 1)  # y is up; so seen from below
    last, uv = len(flat) - 4, flat / 100
    faces = [list(range(last))[::-1], list(range(last, last + 4))]
    if name == "mesh.ply":
        rows: list[list] = [[face, uv[face].ravel().tolist()] for face in faces]
        write(tmp_path, corners.tolist(), XYZ, rows, f"{INDICES},list uchar float texcoord", remarks=("comment TextureFile tex.png",))
    else:
        (tmp_path / "a.mtl").write_text("newmtl x\nmap_Kd tex.png\n")
        lines = [f"v {x} {y} {z}\nvt {u} {v}" for (x, y, z), (u, v) in zip(corners, uv, strict=True)]
        texts = [" ".join(f"{one + 1}/{one + 1}" for one in faces[0]), " ".join(f"{one - len(flat)}/{one - len(flat)}" for one in faces[1])]
        (tmp_path / name).write_text("\n".join(["mtllib a.mtl\nusemtl x", *lines, *(f"f {text}" for text in texts), ""]))
    mesh = read_mesh(tmp_path / name)
    x, z = np.roll(flat[:last], -1, 0).T
    area = abs(flat[:last, 0] @ z - flat[:last, 1] @ x) / 2
    square = mesh.vertices[mesh.faces[:, 0], 0] > 55
    areas, down = mesh.face_areas(), mesh.face_normals()[:, 1] < 0
    assert np.isclose(areas[~square].sum(), area) and len(mesh.faces) == last
    assert (down == square)[areas > 0].all()
    assert np.allclose(mesh.uv * 100, mesh.vertices[:, [0, 2]])
    shared = mesh.vertices[mesh.faces[square]]
    assert all((shared == corners[last + one]).all(2).any(1).all() for one in (0, 2)), "a fan from the first corner"


@pytest.mark.parametrize("form", FORMS)
def test_polygons_become_triangles(tmp_path: Path, form: str) -> None:
    mixed = read_ply(write(tmp_path, [*CORNERS, [-5.0, 10.0, 0.0]], XYZ, [[[0, 1, 2]], [[0, 2, 3, 4]], [[0, 1]]], form=form))
    assert len(mixed.faces) == 3 and np.isclose(mixed.face_areas().sum(), 250)
    assert (mixed.face_normals()[:, 2] > 0.99).all()


def test_faces_whose_corners_have_another_name_are_no_point_cloud(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="4 vertices and 0 faces; .* Its faces have corners, not vertex_indices or vertex_index: rename"):
        read_ply(write(tmp_path, CORNERS, of_face="list uchar int corners"))


def test_line_ends_and_other_elements_do_not_matter(tmp_path: Path) -> None:
    path = write(tmp_path, CORNERS, line_end="\r\n")
    assert np.array_equal(read_ply(path).vertices, CORNERS)
    path.write_bytes(
        path.read_bytes().replace(b"end_header", b"element edge 1\r\nproperty int vertex1\r\nproperty int vertex2\r\nend_header")
        + b"0 1\r\n"
    )
    assert len(read_ply(path).faces) == 2


@pytest.mark.parametrize(
    "remark",
    [
        "comment TextureFile my tex.png",
        "comment texturefile my tex.png",
        "obj_info TextureFile my tex.png",
        r"comment TextureFile C:\scans\my tex.png",
    ],
)
def test_a_texture_is_named_in_many_ways(tmp_path: Path, remark: str) -> None:
    add_texture(tmp_path, "my tex.png")
    rows = [[*corner, *uv] for corner, uv in zip(CORNERS, UV, strict=True)]
    path = write(tmp_path, rows, f"{XYZ},double s,double t", remarks=(remark,))
    assert read_ply(path).is_textured
    content = path.read_bytes().replace(f"{remark}\n".encode(), b"")
    path.write_bytes(content.replace(b"end_header", f"{remark}\nend_header".encode()))
    assert read_ply(path).is_textured, "after the elements"


def test_coordinates_without_an_image_and_images_without_faces_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [[*corner, *uv] for corner, uv in zip(CORNERS, UV, strict=True)]
    read_mesh(write(tmp_path, rows, f"{XYZ},float s,float t"))
    assert "mesh.ply has texture coordinates, but no image for them, and is used without colour; its header" in capsys.readouterr().err
    add_texture(tmp_path)
    read_mesh(write(tmp_path, CORNERS, remarks=("comment TextureFile tex.png",)))
    assert "names the texture tex.png, but has no texture coordinates" in capsys.readouterr().err
    for name in ("A.PNG", "b.png"):
        add_texture(tmp_path, name)
    names = ("comment TextureFile a.png", "comment TextureFile b.png")
    assert read_mesh(write(tmp_path, rows, f"{XYZ},float s,float t", remarks=names)).is_textured, "a.png is A.PNG, as on Windows"
    assert "names 2 textures, but no texnumber says which faces have which; A.PNG is drawn on all" in capsys.readouterr().err


def test_a_vertex_without_a_place_matters_where_a_face_uses_it(tmp_path: Path) -> None:
    nowhere = [float("nan"), 0.0, 0.0]
    mesh = read_ply(write(tmp_path, [*CORNERS, nowhere]))
    assert np.ptp(mesh.vertices, axis=0).tolist() == [10, 20, 0]
    with pytest.raises(StepError, match="places of vertices that faces use are not finite, the first of vertex 3;"):
        read_ply(write(tmp_path, [*CORNERS[:3], nowhere]))
    with pytest.raises(StepError, match="a face has vertex 7, but there are 4"):
        read_ply(write(tmp_path, CORNERS, faces=[[[0, 1, 7]]]))


def test_quality_of_other_programs_is_no_class_of_the_surface(tmp_path: Path) -> None:
    for values, known in (([0.0, 1.0, 0.5, 1.0], True), ([0.0, 17.0, -3.0, 2.0], False)):
        mesh = read_ply(write(tmp_path, [[*corner, value] for corner, value in zip(CORNERS, values, strict=True)], f"{XYZ},float quality"))
        assert (mesh.quality is not None) == known


@pytest.mark.parametrize(
    ("name", "form", "faces"),
    [
        ("meshlab_wedge", "tex", 12),
        ("blender_st", "tex", 12),
        ("vertex_uv", "tex", 12),
        ("face_colors", "color", 12),
        ("mixed_quads_binary", "", 12),
    ],
)
def test_reported_files_are_read(name: str, form: str, faces: int) -> None:
    path = REPORTS / f"{name}.ply"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    mesh = read_ply(path)
    assert len(mesh.faces) == faces and mesh.is_textured == (form == "tex") and mesh.is_colored == bool(form)
    assert np.isclose(mesh.face_areas().sum(), 8800)
