"""Turn a model as a person would put it down for a second pass: upside down where it stands so, otherwise on its side.

Writes a model folder whose model stands in its new way, z up, and `turned.json`, which says how it was turned.
"""

import argparse
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.meshes.mesh_files import write_copy
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.support.placements import LEAST_STABILITY_DEG, Placement, placements_of_hull
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json

LEAST_TURN_DEG = 50.0  # less shows too little of the underside


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--model", type=Path, required=True, help="folder with model.ply, in mm, upright, z up")
    parser.add_argument("--out", type=Path, required=True, help="model folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the turned model."""
    path = args.model / "model.ply"
    mesh = read_ply(path)
    placement = choose_second_placement(mesh, str(path))
    turned_from_model = placement.plane_from_object
    vertices = transform_points(mesh.vertices, turned_from_model)
    normals = None if mesh.normals is None else mesh.normals @ turned_from_model[:3, :3].T
    with atomic_directory(args.out) as folder:
        write_copy(path, replace(mesh, vertices=vertices, normals=normals), folder)
        write_json(folder / "model_info.json", describe(read_json(args.model / "model_info.json"), vertices))
        facts = {"placement": placement.kind, "turned_from_model": turned_from_model.tolist()}
        write_json(folder / "turned.json", facts | {name: asdict(placement)[name] for name in ("probability", "stability_deg")})


def choose_second_placement(mesh: Mesh, name: str) -> Placement:
    """How the object is put down the second time: the likeliest stable way upside down, else the likeliest on its side.

    Raises:
        StepError: it has no second stable way, as a ball does not.
    """
    placements = [one for one in placements_of_hull(mesh.vertices, mesh.vertices[mesh.faces].mean((0, 1))) if is_another(one)]
    if not placements:
        raise StepError(f"{name} rests in one way only, so there is no second pass of it")
    return min(placements, key=lambda one: (one.kind != "flipped", -one.probability))


def is_another(placement: Placement) -> bool:
    """Whether a placement shows what the first one hides; upside down, only if it does not fall over. A round thing that lies may roll."""
    shows = bool(placement.plane_from_object[2, 2] < np.cos(np.radians(LEAST_TURN_DEG)))
    return shows and (placement.kind != "flipped" or placement.stability_deg >= LEAST_STABILITY_DEG)


def describe(info: dict, vertices: np.ndarray) -> dict:
    """model_info.json of a turned model: its name and diameter stay, its box is another."""
    low, size = vertices.min(0), np.ptp(vertices, axis=0)
    box = {f"min_{axis}": round(float(low[index]), 4) for index, axis in enumerate("xyz")}
    box |= {f"size_{axis}": round(float(size[index]), 4) for index, axis in enumerate("xyz")}
    return info | box
