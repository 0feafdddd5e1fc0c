"""Write models_info.json of a folder of models: diameters, boxes and, where asked, the symmetries of their shapes."""

import argparse
from pathlib import Path

from zeroshop_steps.bop.formats.models import describe_model, list_model_files
from zeroshop_steps.bop.shape_symmetry import find_symmetries
from zeroshop_steps.geometry.meshes.mesh_files import describe_others, read_mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of obj_000001.ply and so on, in mm")
    parser.add_argument("--symmetries", action="store_true", help="find rotations that keep the shape; colours do not count")
    parser.add_argument("--out", type=Path, help="file to write (default: models_info.json in the folder, which must not exist yet)")


def run(args: argparse.Namespace) -> None:
    """Describe all models of a folder."""
    files = list_model_files(args.models)
    if not files:
        raise StepError(
            f"{args.models} has no models; expected files such as obj_000001.ply, in millimetres; {describe_others(args.models)}"
        )
    out = args.out or args.models / "models_info.json"
    if args.out is None and out.exists():
        raise StepError(f"{out} exists already, and may know more than the meshes; name another file by --out")
    listed = {}
    for path in files:
        mesh = read_mesh(path)
        entry: dict = describe_model(path, mesh)
        listed[str(int(path.stem[4:]))] = entry | (find_symmetries(mesh, entry["diameter"]) if args.symmetries else {})
    write_json(out, listed)
    symmetric = [number for number, entry in listed.items() if {"symmetries_discrete", "symmetries_continuous"} & set(entry)]
    print(f"{out}: {len(listed)} models, {len(symmetric)} of them symmetric: {', '.join(symmetric) or 'none'}")
