"""The folder that all formats refer to: the textured mesh and the convex parts as OBJ in metres, and body.json with mass and inertia."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.surface_parts import with_texture
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import Record, read_json

VISUAL, TEXTURE, RECORD = "visual.obj", "texture.png", "body.json"
FRAME_TEXT = "origin and axes of the mesh: the bounding box's centre, z up from the support surface, x towards the first camera; metres"
GENERATED_FRAME_TEXT = "origin and axes of the mesh: the bounding box's centre, z up and x as generated; metres"


@dataclass(frozen=True)
class Body:
    """A rigid body as its folder describes it; metres and kilograms, frame of the mesh.

    Attributes:
        folder: of its files.
        name: of the object.
        mass_kg: the mass.
        centre_m: (3,) centre of mass.
        inertia_kg_m2: (3, 3) about the centre of mass, along the frame's axes.
        friction: coefficient of sliding friction.
        parts: names of the convex parts' files in the folder.
        facts: the whole record.
    """

    folder: Path
    name: str
    mass_kg: float
    centre_m: np.ndarray
    inertia_kg_m2: np.ndarray
    friction: float
    parts: tuple[str, ...]
    facts: Record


def read_body(folder: Path) -> Body:
    """Read body.json of a folder. Raises StepError where it is missing or damaged, or names a part that is not there."""
    folder = Path(folder)
    facts = read_json(folder / RECORD)
    try:
        body = Body(
            folder,
            str(facts["name"]),
            float(facts["mass_kg"]),
            np.array(facts["centre_of_mass_m"], float).reshape(3),
            np.array(facts["inertia_kg_m2"], float).reshape(3, 3),
            float(facts["friction"]),
            tuple(facts["parts"]),
            facts,
        )
    except (TypeError, ValueError) as error:
        raise StepError(f"{folder / RECORD} is damaged ({error}); delete the folder and make it again") from None
    for name in (VISUAL, *body.parts):
        if not (folder / name).is_file():
            raise StepError(f"{folder} lacks {name}, which its {RECORD} names; delete the folder and make it again")
    return body


def require_beside(body: Body, out: Path) -> str:
    """The name of the body's folder, which must lie beside `out`: files refer to it by relative paths, so that both can be moved."""
    if body.folder.resolve().parent != out.resolve().parent:
        raise StepError(f"{body.folder} must lie in the folder of {out}, which refers to it by a relative path; name an --out beside it")
    return body.folder.name


def write_textured_obj(folder: Path, mesh: Mesh, name: str = VISUAL) -> None:
    """Write a textured mesh in metres, with its material and texture.png; without any colour, a plain grey one."""
    mesh = with_texture(mesh) if mesh.is_colored else mesh
    material = Path(name).with_suffix(".mtl").name
    lines = [f"mtllib {material}", f"o {Path(name).stem}", *_rows("v", mesh.vertices, "%.7g")]
    uv = mesh.uv if mesh.is_textured else None
    lines += _rows("vt", uv, "%.6f") if uv is not None else []
    lines += [*_rows("vn", mesh.vertex_normals, "%.5f"), "usemtl surface"]
    corner = "%d/%d/%d" if uv is not None else "%d//%d"
    face, times = " ".join(["f", corner, corner, corner]), 3 if uv is not None else 2
    lines += [face % tuple(row) for row in np.repeat(mesh.faces + 1, times, axis=1).tolist()]
    (folder / name).write_text("\n".join(lines) + "\n")
    looks = ["newmtl surface", "Ka 0 0 0", "Kd 1 1 1" if uv is not None else "Kd 0.7 0.7 0.7", "Ks 0 0 0", "Ns 10", "illum 1"]
    (folder / material).write_text("\n".join([*looks, *([f"map_Kd {TEXTURE}"] if uv is not None else [])]) + "\n")
    if uv is not None:
        write_image(folder / TEXTURE, mesh.texture_image)


def write_part_obj(path: Path, part: Mesh) -> None:
    """Write a convex part in metres."""
    lines = [f"o {path.stem}", *_rows("v", part.vertices, "%.7g"), *_rows("f", part.faces + 1, "%d")]
    path.write_text("\n".join(lines) + "\n")


def _rows(word: str, values: np.ndarray, number: str) -> list[str]:
    """One line for each row of (N, C) values."""
    form = " ".join([word, *([number] * values.shape[1])])
    return [form % tuple(row) for row in values.tolist()]
