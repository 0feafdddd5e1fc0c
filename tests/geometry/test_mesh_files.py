"""Models as OBJ and glTF: shape, texture and colours are those of the PLY; nothing outside their folder is read."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from zeroshop_steps.geometry.meshes.mesh_files import describe_others, find_mesh, read_mesh
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.runtime.errors import StepError

BOX_MM = (60.0, 40.0, 20.0)
TRIANGLE = "usemtl x\nv 0 0 0\nv 9 0 0\nv 0 9 0\n"


def textured_box(scale: float = 1.0) -> trimesh.Trimesh:
    box = trimesh.creation.box(BOX_MM)
    box.apply_scale(scale)
    uv = np.random.default_rng(0).random((len(box.vertices), 2))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (8, 8), (200, 100, 50)))
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return box


def change_gltf(path: Path, **changes: object) -> Path:
    """A glTF with other entries at its top."""
    box = textured_box()
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(box)).items():
        (path.parent / name).write_bytes(content)
    facts = json.loads((path.parent / "model.gltf").read_text())
    path.write_text(json.dumps(facts | changes))
    return path


@pytest.mark.parametrize("name", ["box.obj", "box.glb"])
@pytest.mark.parametrize("scale", [1.0, 0.001])
def test_a_textured_model_is_read_in_millimetres(tmp_path: Path, name: str, scale: float, capsys: pytest.CaptureFixture[str]) -> None:
    box = textured_box(scale)
    if name.endswith("obj"):
        box.visual.material = box.visual.material.to_simple()
    box.export(tmp_path / name)
    mesh = read_mesh(tmp_path / name)
    assert np.allclose(np.ptp(mesh.vertices, axis=0), BOX_MM) and len(mesh.faces) == 12
    assert mesh.is_textured and np.abs(mesh.texture.reshape(-1, 3).astype(int) - (200, 100, 50)).max() < 5
    assert ("metres" in capsys.readouterr().err) == (scale < 1)


def test_materials_vertices_and_faces_have_colours(tmp_path: Path) -> None:
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl green\nKd 0 1 0\n")
    vertices = "v 0 0 0\nv 90 0 0\nv 90 90 0\nv 0 90 0\n"
    (tmp_path / "two.obj").write_text(f"mtllib two.mtl\n{vertices}usemtl red\nf 1 2 3\nusemtl green\nf 1 3 4\n")
    mesh = read_mesh(tmp_path / "two.obj")
    assert {tuple(color) for color in mesh.colors[mesh.faces[:, 0]].tolist()} == {(255, 0, 0), (0, 255, 0)}
    box = trimesh.creation.box(BOX_MM)
    box.visual.vertex_colors = np.tile(np.uint8([10, 20, 30, 255]), (8, 1))
    for name in ("box.glb", "box.obj", "box.ply"):
        box.export(tmp_path / name)
        assert (read_mesh(tmp_path / name).colors == (10, 20, 30)).all(), name
    box.export(tmp_path / "plain.stl")
    assert not read_mesh(tmp_path / "plain.stl").is_colored and with_texture(read_mesh(tmp_path / "plain.stl")).is_textured


def test_parts_with_and_without_texture_share_one_image(tmp_path: Path) -> None:
    plain = trimesh.creation.box(BOX_MM)
    plain.visual.vertex_colors = np.tile(np.uint8([10, 20, 30, 255]), (8, 1))
    scene = trimesh.Scene([textured_box()])
    scene.add_geometry(plain, transform=trimesh.transformations.translation_matrix([0, 0, 20]))
    scene.export(tmp_path / "scene.glb")
    mesh = read_mesh(tmp_path / "scene.glb")
    assert len(mesh.faces) == 24 and np.allclose(np.ptp(mesh.vertices, axis=0), (60, 40, 40))
    colors = {tuple(color) for color in mesh.texture.reshape(-1, 3).tolist()}
    assert (10, 20, 30) in colors and (200, 100, 50) in colors


SQUARE = "v 0 0 0\nv 90 0 0\nv 90 90 0\nvt 0 0\nvt 1 0\nvt 1 1\n{}f 1/1 2/2 3/3\n"


@pytest.mark.parametrize(
    "line",
    ["map_Kd t.png", "map_Kd -clamp on T.PNG", "map_Kd -s 1 1 1 -o 0.0 0.0 t.png", r"map_Kd .\t.png", "map_Ka t.png",
     "map_Ka none.png\nmap_Kd t.png", 'map_Kd "t.png"', "map_Kd -mm 0 1 -colorspace sRGB t.png"],
)  # fmt: skip
def test_a_texture_of_mtl_is_named_in_many_ways(tmp_path: Path, line: str) -> None:
    Image.new("RGB", (8, 8), (200, 100, 50)).save(tmp_path / "t.png")
    (tmp_path / "a.mtl").write_text(f"newmtl x\nKd 0 0 0\n{line}\n", encoding="utf-8-sig")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + SQUARE.format("usemtl x\n"), encoding="utf-8-sig")
    assert (read_mesh(tmp_path / "a.obj").texture == (200, 100, 50)).all()


TEXTURED_PLY = (
    "ply\nformat ascii 1.0\ncomment TextureFile {}\nelement vertex 3\n"
    + "".join(f"property float {name}\n" for name in "xyzst")
    + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 0 0\n90 0 0 1 0\n0 90 0 0 1\n3 0 1 2\n"
)
TEXTURED_OBJ = "mtllib a.mtl\nusemtl x\nv 0 0 0\nv 90 0 0\nv 0 90 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize("mesh", ["a.ply", "a.obj"])
@pytest.mark.parametrize(
    ("name", "mode", "options"),
    [("a.tga", "RGBA", {}), ("a.dds", "RGB", {"pixel_format": "DXT1"}), ("a.webp", "RGB", {}), ("a.jpg", "CMYK", {}), ("a.png", "I;16", {}),
     ("a.tif", "F", {})],
)  # fmt: skip
def test_textures_of_many_formats_are_read(tmp_path: Path, mesh: str, name: str, mode: str, options: dict) -> None:
    """Levels of 16 bits become levels of 8; floating ones, whose range nobody says, are refused."""
    levels = {"I;16": np.full((8, 8), 120 * 257, np.uint16), "F": np.full((8, 8), 0.5, np.float32)}
    image = Image.fromarray(levels[mode]) if mode in levels else Image.new("RGB", (8, 8), (120, 120, 120)).convert(mode)
    image.save(tmp_path / name, **options)
    (tmp_path / "a.mtl").write_text(f"newmtl x\nmap_Kd {name}\n")
    (tmp_path / mesh).write_text(TEXTURED_PLY.format(name) if mesh == "a.ply" else TEXTURED_OBJ)
    if mode == "F":
        with pytest.raises(StepError, match=r"texture .*a\.tif of mesh .* of a kind that is not read, .* floats; export it as PNG"):
            read_mesh(tmp_path / mesh)
    else:
        assert np.abs(read_mesh(tmp_path / mesh).texture.astype(int) - 120).max() <= 4


def test_a_line_names_several_materials(tmp_path: Path) -> None:
    for name, color in (("a", (200, 100, 50)), ("b", (0, 90, 200))):
        Image.new("RGB", (8, 8), color).save(tmp_path / f"{name}.png")
        (tmp_path / f"{name}.mtl").write_text(f"newmtl {name}\nmap_Kd {name}.png\n")
    (tmp_path / "two.obj").write_text("mtllib a.mtl b.mtl\n" + SQUARE.format("usemtl b\n"))
    assert (read_mesh(tmp_path / "two.obj").texture == (0, 90, 200)).all()


@pytest.mark.parametrize("name", ["cup.ply", "cup.obj"])
def test_a_folder_is_no_mesh(tmp_path: Path, name: str) -> None:
    with pytest.raises(StepError, match="does not exist; check the path"):
        read_mesh(tmp_path / name)
    (tmp_path / name).mkdir()
    with pytest.raises(StepError, match="is a folder; name the mesh in it"):
        read_mesh(tmp_path / name)


def test_what_a_folder_holds_instead_is_told(tmp_path: Path) -> None:
    assert "is empty, or does not exist" in describe_others(tmp_path / "none")
    (tmp_path / "obj_000001.3mf").touch()
    assert describe_others(tmp_path) == (
        "it holds obj_000001.3mf; meshes that are read end in .ply, .obj, .glb, .gltf, .stl, .off: export it as PLY"
    )
    (tmp_path / "cup.ply").touch()
    assert describe_others(tmp_path) == "it holds cup.ply, obj_000001.3mf"


def test_the_diffuse_texture_of_an_older_extension_is_used(tmp_path: Path) -> None:
    box = trimesh.creation.box((90, 60, 120))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (8, 8), (200, 100, 50)))
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(box)).items():
        (tmp_path / name).write_bytes(content)
    facts = json.loads((tmp_path / "model.gltf").read_text())
    diffuse = {"diffuseTexture": facts["materials"][0].pop("pbrMetallicRoughness")["baseColorTexture"]}
    facts["materials"][0]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": diffuse}
    (tmp_path / "model.gltf").write_text(json.dumps(facts | {"extensionsUsed": ["KHR_materials_pbrSpecularGlossiness"]}))
    assert (read_mesh(tmp_path / "model.gltf").texture == (200, 100, 50)).all()


@pytest.mark.parametrize("full", [1, 255])
def test_colours_of_obj_are_shares_or_bytes(tmp_path: Path, full: int) -> None:
    rows = "".join(f"v {x} {y} 0 {full} {0.4 * full} 0\n" for x, y in ((0, 0), (90, 0), (0, 90)))
    (tmp_path / "a.obj").write_text(rows + "f 1 2 3\n")
    assert (read_mesh(tmp_path / "a.obj").colors == (255, 102, 0)).all()


def test_a_surface_that_glows_has_that_colour(tmp_path: Path) -> None:
    box = trimesh.creation.box((90, 60, 120))
    material = trimesh.visual.material.PBRMaterial(
        emissiveTexture=Image.new("RGB", (8, 8), (200, 100, 50)), emissiveFactor=[1, 1, 1], baseColorFactor=[0, 0, 0, 255]
    )
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    box.export(tmp_path / "a.glb")
    assert (read_mesh(tmp_path / "a.glb").texture == (200, 100, 50)).all()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [("a.obj", b"ply\n", r"a\.obj is no OBJ but PLY: name it \.ply"), ("a.ply", b"version https://git-lfs.github.com/spec", "git lfs pull"),
     ("a.ply", b"PK\x03\x04", "ZIP: unpack it"), ("a.obj", b"glTF\2", r"name it \.glb")],
)  # fmt: skip
def test_a_file_of_another_kind_is_told(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(StepError, match=says):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("lines", ["", "usemtl x\n", "mtllib a.mtl\n", "mtllib a.mtl\nusemtl y\n"])
def test_faces_of_no_known_material_are_plain_and_told(tmp_path: Path, lines: str, capsys: pytest.CaptureFixture[str]) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / "t.png")
    (tmp_path / "a.mtl").write_text("newmtl x\nmap_Kd t.png\n")
    (tmp_path / "a.obj").write_text(SQUARE.format(lines))
    assert not read_mesh(tmp_path / "a.obj").is_colored
    assert r"a.obj has texture coordinates, but no image for them" in (told := capsys.readouterr().err) and "mtllib and usemtl" in told


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.obj", f"mtllib ../secret.mtl\n{TRIANGLE}f 1 2 3\n", r"a\.obj names the file \.\./secret\.mtl, which is outside"),
        ("b.obj", f"mtllib b.mtl\n{TRIANGLE}vt 0 0\nf 1/1 2/1 3/1\n", r"b\.obj names the file .*secret\.png, which is outside"),
        ("c.obj", f"mtllib none.mtl\n{TRIANGLE}f 1 2 3\n", r"c\.obj names none\.mtl, but .* does not exist"),
        ("z.obj", "mtllib z.mtl\n" + SQUARE.format("usemtl x\n"), r"texture .*empty\.png of mesh .*z\.obj is empty, damaged"),
        ("s.obj", "mtllib s.mtl\n" + SQUARE.format("usemtl x\n"), r"s\.obj changes its texture by options, .*: -s 2 2 1 empty\.png"),
        ("t.obj", "mtllib z.mtl none.mtl\n" + SQUARE.format(""), r"t\.obj names none\.mtl, but .* does not exist"),
        ("u.obj", f"{TRIANGLE}f 0 1 2\n", r"u\.obj has a face of vertex 0, but OBJ counts from 1"),
        ("d.stl", "a header", r"d\.stl has no faces, or is cut off"),
        ("d.obj", "v 0 0 0\nv 9 0 0\n", r"d\.obj has no faces"),
        ("e.obj", "", r"e\.obj"),
        ("f.glb", "no glTF", r"f\.glb cannot be read as glTF"),
        ("g.xyz", "1 2 3", r"g\.xyz is of no format that is read: \.ply, \.obj"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path: Path, name: str, content: str, says: str) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "secret.png")
    (tmp_path / "secret.mtl").write_text("newmtl x\nKd 1 0 0\n")
    (folder / "b.mtl").write_text(f"newmtl x\nmap_Kd {tmp_path / 'secret.png'}\n")
    (folder / "z.mtl").write_text("newmtl x\nmap_Kd empty.png\n")
    (folder / "s.mtl").write_text("newmtl x\nmap_Kd -s 2 2 1 empty.png\n")
    (folder / "empty.png").touch()
    (folder / name).write_text(content)
    with pytest.raises(StepError, match=says):
        read_mesh(folder / name)


@pytest.mark.parametrize("uri", ["../secret.bin", "/etc/hostname", "%2e%2e/secret.bin", "file:///etc/hostname"])
def test_gltf_leads_nowhere_else(tmp_path: Path, uri: str) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(bytes(4096))
    path = change_gltf(tmp_path / "in/box.gltf")
    assert len(read_mesh(path).faces) == 12
    facts = json.loads(path.read_text())
    change_gltf(path, buffers=[facts["buffers"][0] | {"uri": uri}])
    with pytest.raises(StepError, match=r"box\.gltf names .*(outside its folder|does not exist)"):
        read_mesh(path)


def test_a_second_set_of_texture_coordinates_is_refused(tmp_path: Path) -> None:
    look = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}}}
    with pytest.raises(StepError, match="uses a second set of texture coordinates, which is not read"):
        read_mesh(change_gltf(tmp_path / "a.gltf", materials=[look]))


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ({"offset": [0.25, 0.5]}, lambda u, v: (u + 0.25, v + 0.5)),
        ({"offset": [0, 1], "scale": [2, -1], "texCoord": 0}, lambda u, v: (2 * u, 1 - v)),
        ({"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.25]}, lambda u, v: (v / 4, 1 - u / 2)),  # as in the extension's example
    ],
)
def test_transformed_texture_coordinates_of_gltf_are_read(tmp_path: Path, transform: dict, expected: Callable) -> None:
    plain = read_mesh(change_gltf(tmp_path / "a.gltf"))
    material = json.loads((tmp_path / "a.gltf").read_text())["materials"][0]
    material["pbrMetallicRoughness"]["baseColorTexture"] |= {"texCoord": 1 if "texCoord" in transform else 0}
    material["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {"KHR_texture_transform": transform}
    used = {"extensionsUsed": ["KHR_texture_transform"], "extensionsRequired": ["KHR_texture_transform"]}
    mesh = read_mesh(change_gltf(tmp_path / "b.gltf", materials=[material], **used))
    np.testing.assert_allclose(mesh.uv, np.stack(expected(*(plain.uv * (1, -1) + (0, 1)).T), 1) * (1, -1) + (0, 1), atol=1e-6)
    with pytest.raises(StepError, match="uses KHR_texture_transform with two materials of one name, which is not read"):
        read_mesh(change_gltf(tmp_path / "c.gltf", materials=[material, material], **used))


def test_colours_of_off_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for colors in ("", " 255 0 0"):
        (tmp_path / "a.off").write_text(f"OFF\n3 1 0\n0 0 0\n90 0 0\n0 90 0\n3 0 1 2{colors}\n")
        assert len(read_mesh(tmp_path / "a.off").faces) == 1
        assert ("a.off has colours, which are not read of OFF" in capsys.readouterr().err) == bool(colors)


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"])
def test_compression_is_refused_by_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(StepError, match=rf"box\.gltf uses {name}, which is not read here; export it without"):
        read_mesh(change_gltf(tmp_path / "box.gltf", extensionsUsed=[name], extensionsRequired=[name]))


def test_ply_is_preferred(tmp_path: Path) -> None:
    assert find_mesh(tmp_path / "obj_000001") is None
    for suffix in (".STL", ".glb", ".ply"):
        (tmp_path / f"obj_000001{suffix}").touch()
        assert find_mesh(tmp_path / "obj_000001") == tmp_path / f"obj_000001{suffix}"
