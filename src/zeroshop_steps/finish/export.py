"""Write the finished mesh: a PLY with its PNG in millimetres, a GLB in metres with y up, and a JSON that describes both."""

import importlib.metadata
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from zeroshop_steps import __version__
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.meshes.units import M_PER_MM
from zeroshop_steps.runtime.files import atomic_write, read_json, write_json

PACKAGES = ("numpy", "torch", "pycolmap", "open3d", "trimesh", "pymeshlab", "xatlas", "opencv-python-headless", "numba")
ROUGHNESS = 0.9  # of the GLB's material: nearly matt, since the texture already shows the light of the photos
FRAME_TEXT = "origin at the bounding-box centre, z up from the support surface, x towards the first camera, right-handed"


def move_to_object_frame(mesh: Mesh, object_from_registration: np.ndarray, texture: np.ndarray) -> Mesh:
    """The textured mesh moved by a (4, 4) similarity, with fresh normals."""
    vertices = transform_points(mesh.vertices, object_from_registration)
    return Mesh(vertices, mesh.faces, None, mesh.uv, texture).with_normals()


def make_metadata(mesh: Mesh, frame: dict, stages: Mapping[str, dict]) -> dict:
    """The content of mesh.json.

    Args:
        mesh: in the object frame.
        frame: content of frame.json.
        stages: contents of the earlier steps' JSONs, by step.
    """
    seconds = {name: found for name, content in stages.items() if (found := _seconds(content)) is not None}
    given = {name: stages["stereo"][name] for name in ("given_depth",) if name in stages.get("stereo", {})}
    cpu_seconds = {name: content["cpu_seconds"] for name, content in stages.items() if "cpu_seconds" in content}
    return {
        "ply_unit": "millimetre" if frame["scale"] == "known" else "unknown",
        "glb_unit": "metre" if frame["scale"] == "known" else "unknown",
        "scale": frame["scale"],
        "scale_source": frame["scale_source"],
        "height_m": frame["height_m"],
        "height_deviation_m": frame["height_deviation_m"],
        **given,
        "frame": FRAME_TEXT,
        "underside": stages.get("closed", {}).get("underside"),
        "closing": stages.get("closed", {}).get("closing"),
        "hollow": stages.get("closed", {}).get("hollow"),
        "frame_facts": {key: value for key, value in frame.items() if key != "seconds"},
        "extents": [round(float(extent), 4) for extent in np.ptp(mesh.vertices, axis=0)],
        "faces": len(mesh.faces),
        "texture_px": mesh.texture_image.shape[0],
        "seconds": seconds | {"total": round(sum(seconds.values()), 2)},
        "cpu_seconds": cpu_seconds,
        "parameters": {name: content["parameters"] for name, content in stages.items() if "parameters" in content},
        "versions": {"zeroshop": __version__} | {name: _version(name) for name in PACKAGES},
    }


def summarize_product(mesh: Mesh, frame: dict) -> str:
    """Size and frame in one line for the log."""
    size = " x ".join(f"{extent:.1f}" for extent in np.ptp(mesh.vertices, axis=0))
    return f"{size} {'mm' if frame['scale'] == 'known' else '(scale unknown)'}, up from {frame['up_source']}"


def write_product(path: Path, mesh: Mesh, metadata: dict) -> None:
    """Write `path` (PLY) with .png, .glb and .json beside it. The PLY is written last: if it exists, everything does."""
    texture = path.with_suffix(".png")
    write_image(texture, mesh.texture_image)
    write_glb(path.with_suffix(".glb"), mesh, M_PER_MM if metadata["scale"] == "known" else 1.0)
    write_json(path.with_suffix(".json"), metadata)
    write_ply(path, mesh, texture.name)


def write_glb(path: Path, mesh: Mesh, scale: float) -> None:
    """Write binary glTF with y up: (x, y, z) becomes (x, z, -y) times `scale`. trimesh flips v to glTF's upper-left origin."""
    y_up = scale * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(mesh.texture_image), metallicFactor=0.0, roughnessFactor=ROUGHNESS, doubleSided=True
    )
    exported = trimesh.Trimesh(
        mesh.vertices @ y_up.T,
        mesh.faces,
        vertex_normals=(mesh.vertex_normals @ y_up.T) / scale,
        visual=trimesh.visual.TextureVisuals(uv=mesh.texture_coordinates, material=material),
        process=False,
    )
    with atomic_write(path) as temporary:
        content = exported.export(file_type="glb", include_normals=True)
        assert isinstance(content, bytes)
        temporary.write_bytes(content)


def _seconds(content: dict) -> float | None:
    """The seconds of a step: one number, or the `total` of several."""
    seconds = content.get("seconds")
    return seconds.get("total") if isinstance(seconds, dict) else seconds


def read_stages(paths: Iterable[Path]) -> dict[str, dict]:
    """The JSONs of earlier steps, by the names that mesh.json gives to them."""
    names = {"registration": "register", "training": "nvs"}
    return {names.get(path.stem, path.stem): read_json(path) for path in paths}


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
