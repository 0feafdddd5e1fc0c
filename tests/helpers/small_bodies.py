"""Bodies whose mass properties are known in closed form, as finished meshes with a texture."""

from pathlib import Path

import numpy as np
import trimesh

from helpers.faults import step
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.runtime.files import write_json

BOX_MM = np.array([60.0, 40.0, 20.0])
CYLINDER_MM = (30.0, 120.0)  # radius, height
MASS_KG = 0.25
SHIFT_MM = np.array([7.0, -3.0, 11.0])  # of the centre from the origin


def write_product(path: Path, shape: trimesh.Trimesh, scale: str = "known") -> Path:
    """A textured mesh in mm, its texture, and the JSON with its scale."""
    vertices = np.asarray(shape.vertices, float)
    uv = (vertices[:, :2] - vertices[:, :2].min(0)) / np.ptp(vertices[:, :2], axis=0)
    texture = np.random.default_rng(0).integers(0, 255, (32, 32, 3), dtype=np.uint8)
    write_image(path.with_suffix(".png"), texture)
    write_ply(path, Mesh(vertices, np.asarray(shape.faces, np.int64), uv=uv).with_normals(), path.with_suffix(".png").name)
    known = scale == "known"
    facts = {"scale": scale, "scale_source": "known_height", "height_m": 0.1 if known else None}
    write_json(path.with_suffix(".json"), facts | {"height_deviation_m": 0.001 if known else None})
    return path


def make_box() -> trimesh.Trimesh:
    """A box off the origin."""
    return trimesh.creation.box(BOX_MM).apply_translation(SHIFT_MM)


def make_cylinder() -> trimesh.Trimesh:
    """A cylinder off the origin."""
    return trimesh.creation.cylinder(*CYLINDER_MM, sections=96).apply_translation(SHIFT_MM)


def box_inertia_kg_m2(mass_kg: float) -> np.ndarray:
    """(3, 3) of the box about its centre."""
    x, y, z = BOX_MM / 1000
    return np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2]) * mass_kg / 12


def cylinder_inertia_kg_m2(mass_kg: float) -> np.ndarray:
    """(3, 3) of the cylinder about its centre."""
    radius, height = np.array(CYLINDER_MM) / 1000
    across = mass_kg * (3 * radius**2 + height**2) / 12
    return np.diag([across, across, mass_kg * radius**2 / 2])


def make_formats(folder: Path, shape: trimesh.Trimesh) -> Path:
    """The mesh, its body and the files of every format in a folder."""
    mesh = write_product(folder / "2dgs.ply", shape)
    body = folder / "2dgs.body"
    assert step("assets", "body", mesh=mesh, name="thing", mass_kg=MASS_KG, friction=0.6, out=body) == 0
    for method, end in (("urdf", "urdf"), ("mjcf", "mjcf.xml"), ("usd", "usda"), ("usd", "usdz")):
        assert step("assets", method, body=body, out=folder / f"2dgs.{end}") == 0
    return folder
