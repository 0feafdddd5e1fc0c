"""Export the models of a dataset to a folder in BOP's layout: obj_000001.ply and its texture, ..., and models_info.json.

The parts are true models (folders with model.ply and model_info.json) or alignments (aligned.json with mesh.ply beside it), whose
meshes are transformed to the frames of their true models. Any BOP method can use the folder as its models. If evidence.npz lies beside
an alignment, the vertices have it as `quality`: 1 measured, 0.5 assumed, 0 never seen. Objects whose part records a failure are left
out with a warning. With --own-frames, meshes keep the frame and the scale that they were made with, as a robot gets them; then no
symmetries are listed.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.models import describe_model, model_path
from zeroshop_steps.geometry.cameras.transforms import transform_points
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, write_ply
from zeroshop_steps.geometry.observation.support_classes import with_surface_support
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.failures import read_failure
from zeroshop_steps.runtime.files import atomic_directory, read_json, write_json

READS_FAILURES = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--parts", type=Path, nargs="+", required=True, help="model folders, or aligned.json files")
    parser.add_argument("--own-frames", action="store_true", help="leave meshes in their own frame and scale")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Write one folder of models."""
    listed: dict[int, dict] = {}
    with atomic_directory(args.out) as folder:
        for part in args.parts:
            failure = read_failure(part)
            if failure:
                warn(f"{part} is left out of {args.out}: {failure}")
                continue
            mesh, info = read_part(part, args.own_frames)
            number = info["obj_id"]
            if number in listed:
                raise StepError(f"{part} is object {number}, and so is an earlier part; give every object once")
            listed[number] = write_model(folder, mesh, info)
        if not listed:
            raise StepError(f"no object is left for {args.out}: every part is the record of a failure; the warnings give the reasons")
        write_json(folder / "models_info.json", {str(number): listed[number] for number in sorted(listed)})
    print(f"{args.out}: {len(listed)} of {len(args.parts)} objects", file=sys.stderr)


def read_part(part: Path, own_frame: bool = False) -> tuple[Mesh, dict]:
    """A mesh in the frame of its true model in mm, and that model's entry of models_info.json; or in the mesh's own frame, without."""
    if part.is_dir():
        return read_ply(part / "model.ply"), read_json(part / "model_info.json")
    aligned = read_json(part)
    mesh, transform = read_ply(part.with_name("mesh.ply")), np.array(aligned["truth_from_mesh"])
    evidence = part.with_name("evidence.npz")
    if evidence.is_file():
        mesh = with_surface_support(mesh, evidence)
    if own_frame:
        return mesh, {"obj_id": aligned["model_info"]["obj_id"], "name": aligned["model_info"].get("name", "")}
    return replace(mesh, vertices=transform_points(mesh.vertices, transform)).with_normals(), aligned["model_info"]


def write_model(folder: Path, mesh: Mesh, info: dict) -> dict:
    """Write one model and its texture. Returns its entry of models_info.json: sizes of this mesh, symmetries of the true model.

    Raises:
        StepError: the mesh is not in millimetres.
    """
    path = model_path(folder, info["obj_id"])
    texture = path.with_suffix(".png") if mesh.texture is not None else None
    if texture:
        write_image(texture, mesh.texture_image)
    write_ply(path, mesh if mesh.normals is not None else mesh.with_normals(), texture.name if texture else None)
    entry = {"name": info.get("name", path.stem)} | describe_model(path, mesh)
    return entry | {key: info[key] for key in ("symmetries_discrete", "symmetries_continuous") if info.get(key)}
