"""Damage models on purpose, to see what poses estimated with them lose: a wrong scale, or a missing underside.

Both are faults of meshes made from a film around an object whose height was estimated. The scale is wrong about the centre of the
bounding box, which is the origin of a reconstructed mesh; of all models alike, or of each as it is said. The underside is what no
camera of a ring at 0 degrees or higher sees: the faces that look down, in the lowest tenth of the height.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.export_models import write_model
from zeroshop_steps.bop.formats.models import read_models, read_models_info
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, write_json

LOWEST_SHARE = 0.1
"""Of the height."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout, upright, z up")
    parser.add_argument("--scale-percent", type=float, default=0.0, help="how much too large; negative: too small (default: %(default)s)")
    own_help = "the same for single models, in place of --scale-percent"
    parser.add_argument("--scale-percent-of", nargs="*", default=[], metavar="OBJECT=PERCENT", help=own_help)
    parser.add_argument("--open-underside", action="store_true", help="leave out the faces that a ring of cameras never sees")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write the damaged models."""
    own = read_scale_errors(args.scale_percent_of)
    for percent in (args.scale_percent, *own.values()):
        if not -90 <= percent <= 900:
            raise StepError(f"{percent:g} % is no error of a scale; expected -90 to 900")
    listed = {}
    with atomic_directory(args.out) as folder:
        for number, model in read_models(args.models, map(int, read_models_info(args.models))).items():
            factor = 1 + own.get(number, args.scale_percent) / 100
            mesh, info = scale_mesh(model.mesh, factor), scale_symmetries(model.info, model.mesh, factor)
            mesh = open_underside(mesh) if args.open_underside else mesh
            if not len(mesh.faces):
                raise StepError(f"nothing is left of object {number} in {args.models} without its underside")
            listed[str(number)] = write_model(folder, mesh, info | {"obj_id": number})
        write_json(folder / "models_info.json", listed)


def read_scale_errors(words: list[str]) -> dict[int, float]:
    """The errors in per cent by object, from words such as 5=5.79; raises StepError with one that is none."""
    found = {}
    for word in words:
        number, _, percent = word.partition("=")
        try:
            found[int(number)] = float(percent)
        except ValueError:
            raise StepError(f"--scale-percent-of {word} is no OBJECT=PERCENT, such as 5=5.79") from None
    return found


def scale_mesh(mesh: Mesh, factor: float) -> Mesh:
    """The mesh, `factor` times as large about the centre of its bounding box."""
    centre = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    return replace(mesh, vertices=centre + factor * (mesh.vertices - centre))


def scale_symmetries(info: dict, mesh: Mesh, factor: float) -> dict:
    """The model's entry of models_info.json with symmetries for `scale_mesh`."""
    centre = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    discrete = []
    for values in info.get("symmetries_discrete", []):
        moved = np.array(values, float).reshape(4, 4)
        # R p + t maps the model onto itself; of the scaled one, so does R p + t', which this gives.
        moved[:3, 3] = centre - moved[:3, :3] @ centre + factor * (moved[:3, 3] - centre + moved[:3, :3] @ centre)
        discrete.append(moved.ravel().tolist())
    continuous = [
        axis | {"offset": (centre + factor * (np.array(axis["offset"], float) - centre)).tolist()}
        for axis in info.get("symmetries_continuous", [])
    ]
    return info | {"symmetries_discrete": discrete, "symmetries_continuous": continuous}


def open_underside(mesh: Mesh) -> Mesh:
    """The mesh without the faces that look down in the lowest tenth of its height, and without the vertices that only these had."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
    down = normals[:, 2] < -0.5 * np.linalg.norm(normals, axis=1)
    lowest = corners[:, :, 2].mean(1) < low + LOWEST_SHARE * (high - low)
    return replace(mesh, faces=mesh.faces[~(down & lowest)]).without_loose_vertices()
