"""Meshes in metres for robots, from files whose scale is on record; a mesh of unknown scale is refused unless the user says otherwise."""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from zeroshop_steps.geometry.meshes.mesh_files import read_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import M_PER_MM
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json

REFUSE, MILLIMETRES = "refuse", "millimetres"


@dataclass(frozen=True)
class MetricMesh:
    """A mesh in metres and what is known of its size.

    Attributes:
        mesh: vertices in metres, in the object's frame.
        scale: `known`; or `assumed`, where the user had a mesh of unknown scale taken for millimetres.
        scale_source: how the scale was measured; `model` for a true model.
        relative_deviation: standard deviation of the scale, as a share of it.
        generated: whether the whole mesh is a network's guess.
    """

    mesh: Mesh
    scale: str
    scale_source: str
    relative_deviation: float
    generated: bool = False


def add_mesh_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of steps that need a mesh of known scale."""
    parser.add_argument(
        "--mesh", type=Path, required=True, help="finished mesh in mm with its JSON beside it, or a true model with its model_info.json"
    )
    add_unknown_scale_argument(parser)


def add_unknown_scale_argument(parser: argparse.ArgumentParser) -> None:
    """What to do with meshes of unknown scale."""
    parser.add_argument(
        "--unknown-scale",
        choices=[REFUSE, MILLIMETRES],
        default=REFUSE,
        help="what to do with a mesh of unknown scale: refuse it, or take its unit for millimetres",
    )


def read_metric_mesh(path: Path, unknown_scale: str = REFUSE) -> MetricMesh:
    """Read a mesh in metres.

    Args:
        path: a finished mesh (PLY, mm) with its JSON beside it, or a model with model_info.json or models_info.json beside it.
        unknown_scale: REFUSE, or MILLIMETRES to take the unit of a mesh of unknown scale for millimetres.

    Raises:
        StepError: the scale is unknown, or the mesh is missing or damaged.
    """
    path = Path(path)
    mesh = read_mesh(path)
    scale, source, deviation = _read_scale(path)
    generated = is_generated(path)
    if generated:
        warn(f"{path} was generated without cameras: its shape is a guess, and so are all sizes but its height. Measure it by 2dgs")
    if scale != "known":
        if unknown_scale == REFUSE:
            lack = f" ({path.with_suffix('.json').name} does not exist)" if source == "none" else ""
            raise StepError(
                f"the scale of {path} is unknown{lack}, and a robot would take it for {_size_text(mesh)} mm. Give the object's height"
                " (height_m in objects.tsv), a printed board or depth images; or, if its unit is millimetres, set"
                " unknown_scale: millimetres (--unknown-scale millimetres)"
            )
        warn(f"the scale of {path} is unknown; its unit is taken for millimetres, as unknown_scale says")
        scale, source, deviation = "assumed", MILLIMETRES, 0.0
    return MetricMesh(replace(mesh, vertices=mesh.vertices * M_PER_MM), scale, source, deviation, generated)


def is_generated(path: Path) -> bool:
    """Whether the whole finished mesh is a network's guess, which was made without cameras; its JSON says so."""
    record = path.with_suffix(".json")
    return record.is_file() and bool(read_json(record).get("generated"))


def _read_scale(path: Path) -> tuple[str, str, float]:
    """`known` or `unknown`, its source, and its standard deviation as a share."""
    record = path.with_suffix(".json")
    if record.is_file():
        facts = read_json(record)
        height_m, deviation_m = facts["height_m"], facts["height_deviation_m"]
        return facts["scale"], str(facts["scale_source"]), deviation_m / height_m if height_m and deviation_m else 0.0
    if any((path.parent / name).is_file() for name in ("model_info.json", "models_info.json")):
        return "known", "model", 0.0
    return "unknown", "none", 0.0


def _size_text(mesh: Mesh) -> str:
    return " x ".join(f"{extent:.3g}" for extent in mesh.vertices.max(0) - mesh.vertices.min(0))
