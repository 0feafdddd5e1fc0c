"""Faults of models: PLY files and their textures."""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from helpers.faults import Fault, step
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply

MODEL = "obj_000001.ply"


def make_model(folder: Path) -> Path:
    """A textured box in a folder of models."""
    box = trimesh.creation.box((60, 40, 50))
    uv = np.random.default_rng(0).random((len(box.vertices), 2))
    write_image(folder / "models/obj_000001.png", np.full((32, 32, 3), 90, np.uint8))
    write_ply(folder / "models" / MODEL, Mesh(np.asarray(box.vertices), np.asarray(box.faces), uv=uv), "obj_000001.png")
    return folder / "models"


def take_model(spoil: Callable[[Path], object]) -> Callable[[Path], int]:
    """Take a model that `spoil` has changed from a dataset in BOP's layout."""

    def run(folder: Path) -> int:
        models = make_model(folder)
        spoil(models)
        return step("synthetic", "bop_models", dataset="own", object="obj_000001", models=models, out=folder / "model")

    return run


def name_texture(name: str) -> Callable[[Path], None]:
    """Another file in the model's comment, which exists."""

    def spoil(models: Path) -> None:
        image = np.full((32, 32, 3), 90, np.uint8)
        write_image(models.parent / "secret.png", image)
        path = models / MODEL
        wanted = name.replace("HERE", str(models.parent)).encode()
        path.write_bytes(path.read_bytes().replace(b"TextureFile obj_000001.png", b"TextureFile " + wanted))

    return spoil


def with_coordinate(value: float) -> Callable[[Path], None]:
    """One texture coordinate of this value."""

    def spoil(models: Path) -> None:
        box = trimesh.creation.box((60, 40, 50))
        uv = np.full((len(box.vertices), 2), 0.5)
        uv[3, 1] = value
        write_ply(models / MODEL, Mesh(np.asarray(box.vertices), np.asarray(box.faces), uv=uv), "obj_000001.png")

    return spoil


def write_huge_texture(models: Path) -> None:
    """A PNG of 2^15 x 2^16 pixels, all black, which takes 260 KB."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    squeezer, rows = zlib.compressobj(9), b""
    for _ in range(1 << 16):
        rows += squeezer.compress(bytes((1 << 12) + 1))
    rows += squeezer.flush()
    header = struct.pack(">IIBBBBB", 1 << 15, 1 << 16, 1, 0, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    (models / "obj_000001.png").write_bytes(content)


def replace_by(name: str, content: bytes) -> Callable[[Path], None]:
    """Another file in place of the model."""

    def spoil(models: Path) -> None:
        (models / MODEL).unlink()
        (models / name).write_bytes(content)

    return spoil


def as_points(models: Path) -> None:
    """The vertices of the model alone."""
    path = models / MODEL
    header, _, body = path.read_bytes().partition(b"element face")
    path.write_bytes(header + b"end_header\n" + body.partition(b"end_header\n")[2])


def as_gaussians(models: Path) -> None:
    """Gaussian splats, as 3DGS writes them (meshlab 1436)."""
    names = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3")
    header = ["ply", "format binary_little_endian 1.0", "element vertex 8", *(f"property float {name}" for name in names), "end_header", ""]
    values = np.random.default_rng(0).random((8, len(names)), np.float32)
    (models / MODEL).write_bytes("\n".join(header).encode() + values.tobytes())


def with_texture_named(name: str) -> bytes:
    """A glTF whose texture is that file."""
    content = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box((60, 40, 50))))["model.gltf"]
    facts = json.loads(content)
    facts["buffers"] = [{"byteLength": 100, "uri": name}]
    return json.dumps(facts).encode()


TRIANGLE = b"v 0 0 0\nv 90 0 0\nv 0 90 0\nusemtl x\nf 1 2 3\n"
DRACO = json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}).encode()
OUTSIDE = (r"obj_000001\.ply names the texture", "outside its folder", "beside the mesh")
FAULTS = [
    *(
        Fault(f"a texture at {name}", take_model(name_texture(name)), OUTSIDE)
        for name in ("HERE/secret.png", "../secret.png", "a/../../b.png")
    ),
    *(
        Fault(f"a texture coordinate of {value}", take_model(with_coordinate(value)), (r"obj_000001\.ply", "texture coordinates", "unwrap"))
        for value in (float("nan"), 1e30, float("-inf"))
    ),
    Fault(
        "a texture above 2^30 pixels", take_model(write_huge_texture), (r"obj_000001\.png is larger than OpenCV reads", "export it smaller")
    ),
    Fault("a point cloud", take_model(as_points), (r"obj_000001\.ply has 8 vertices and 0 faces", "point cloud: make a surface")),
    Fault("3D Gaussians", take_model(as_gaussians), (r"obj_000001\.ply has 8 vertices and 0 faces", "3D Gaussians.*make a surface")),
    Fault(
        "half a header",
        take_model(replace_by(MODEL, b"ply\nformat ascii 1.0\nelement vertex 3\n")),
        (r"obj_000001\.ply cannot be read", "its header does not end", "export it again"),
    ),
    Fault(
        "an OBJ whose material is elsewhere",
        take_model(replace_by("obj_000001.obj", b"mtllib ../../etc/x.mtl\n" + TRIANGLE)),
        (r"obj_000001\.obj names the file \.\./\.\./etc/x\.mtl", "outside its folder", "beside the mesh"),
    ),
    *(
        Fault(
            f"a glTF whose data are at {name}",
            take_model(replace_by("obj_000001.gltf", with_texture_named(name))),
            (r"obj_000001\.gltf names the file", "outside its folder"),
        )
        for name in ("/etc/hostname", "../secret.bin")
    ),
    Fault(
        "a glTF compressed by Draco",
        take_model(replace_by("obj_000001.gltf", DRACO)),
        (r"obj_000001\.gltf uses KHR_draco_mesh_compression", "export it without compression"),
    ),
    Fault("no texture", take_model(lambda models: (models / "obj_000001.png").unlink()), (r"obj_000001\.png does not exist",)),
    Fault(
        "models_info as a list", take_model(lambda models: (models / "models_info.json").write_text("[]")), (r"models_info\.json", "object")
    ),
    Fault(
        "diameter 0", take_model(lambda models: (models / "models_info.json").write_text('{"1": {"diameter": 0}}')), (r"models_info\.json",)
    ),
    Fault(
        "a symmetry about nothing",
        take_model(
            lambda models: (models / "models_info.json").write_text(
                '{"1": {"diameter": 87.7, "symmetries_continuous": [{"axis": [0, 0, 0], "offset": [0, 0, 0]}]}}'
            )
        ),
        (r"object 1 in .*models_info\.json", "axis of length 1"),
    ),
]
