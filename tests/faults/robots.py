"""Faults of meshes that are to become bodies and grasps for robots."""

from collections.abc import Callable
from pathlib import Path

import trimesh

from helpers.faults import Fault, step
from helpers.small_bodies import make_box, write_product
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply


def body_of(scale: str = "known", spoil: Callable[[Path], object] = lambda mesh: None, **options: object) -> Callable[[Path], int]:
    """Make a body of a box that `spoil` has changed."""

    def run(folder: Path) -> int:
        mesh = write_product(folder / "2dgs.ply", make_box(), scale)
        spoil(mesh)
        return step("assets", "body", mesh=mesh, out=folder / "2dgs.body", **(options or {"mass_kg": 0.2}))

    return run


def grasps_of(shape: trimesh.Trimesh, scale: str = "known", spoil: Callable[[Path], object] = lambda mesh: None) -> Callable[[Path], int]:
    """Find grasps of a shape that `spoil` has changed."""

    def run(folder: Path) -> int:
        mesh = write_product(folder / "2dgs.ply", shape, scale)
        spoil(mesh)
        return step("grasp", "antipodal", mesh=mesh, samples=50, out=folder / "grasps.json")

    return run


def open_top(mesh: Path) -> None:
    """Take the faces at the top away."""
    whole = read_ply(mesh)
    write_ply(mesh, type(whole)(whole.vertices, whole.faces[whole.face_normals()[:, 2] < 0.5]))


def turn_over(mesh: Path) -> None:
    """Turn all faces inside out."""
    whole = read_ply(mesh)
    write_ply(mesh, type(whole)(whole.vertices, whole.faces[:, ::-1]))


def give_a_density(folder: Path) -> int:
    """A mass of 0.2 given as a density, as if it were in g/cm^3."""
    return body_of(density_kg_m3=0.8)(folder)


UNKNOWN = (r"scale of .*2dgs\.ply is unknown", "height_m", "unknown_scale: millimetres")
OPEN = (r"2dgs\.ply is open \(4 edges", "no volume", r"finish: \{underside: closed, holes: closed\}")
FAULTS = [
    Fault("a body of unknown scale", body_of("unknown"), UNKNOWN),
    Fault("grasps of unknown scale", grasps_of(make_box(), "unknown"), UNKNOWN),
    Fault("a body of an open mesh", body_of(spoil=open_top), OPEN),
    Fault("grasps of an open mesh", grasps_of(make_box(), spoil=open_top), OPEN),
    Fault("a body of a mesh that is inside out", body_of(spoil=turn_over), (r"2dgs\.ply is inside out", "turn its faces")),
    Fault("a body without a mass", body_of(friction=0.5), (r"2dgs\.ply has no mass", "mass_kg", "objects.tsv", r"assets\.density_kg_m3")),
    Fault("a mass in grams", body_of(mass_kg=603), (r"2dgs\.ply would weigh 603 kg", "kilograms")),
    Fault("a density in grams per cubic centimetre", give_a_density, (r"2dgs\.ply would weigh", "kilograms")),
    Fault("a mesh without its record", body_of(spoil=lambda mesh: mesh.with_suffix(".json").unlink()), UNKNOWN),
    Fault(
        "grasps of what is wider than the gripper",
        grasps_of(trimesh.creation.box((300, 300, 300))),
        (r"2dgs\.ply has no grasp for hsr", "opens wider"),
    ),
]
