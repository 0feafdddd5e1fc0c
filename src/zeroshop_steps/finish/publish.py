"""Copy the chosen cell's product to its final place, with the texture's name rewritten in the PLY."""

import argparse
import shutil
from pathlib import Path

from zeroshop_steps.errors import StepError
from zeroshop_steps.files import read_json, write_json, written_whole
from zeroshop_steps.meshes import read_ply, write_ply


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cell", type=Path, required=True, help="folder of the chosen cell, with mesh.ply, .png, .glb and .json")
    parser.add_argument("--quality", type=Path, help="quality.json of the cell")
    parser.add_argument(
        "--out", type=Path, required=True, help="e.g. results/demo/mug/2dgs.ply; .png, .glb, .json and .preview.png go beside it"
    )


def run(args: argparse.Namespace) -> None:
    publish(args.cell, args.out, args.quality)


def publish(cell: Path, out: Path, quality: Path | None) -> None:
    """Write `out` and its companions from `cell`; the PLY comes last, so a whole PLY means a whole product."""
    for name in ("mesh.ply", "mesh.png", "mesh.glb", "mesh.json"):
        if not (cell / name).is_file():
            raise StepError(f"{cell / name} does not exist; run `finish --method export` for this cell first")
    mesh = read_ply(cell / "mesh.ply")
    notes = read_json(cell / "mesh.json")
    if quality:
        notes["quality"] = read_json(quality)
    texture = out.with_suffix(".png")
    pairs = [(cell / "mesh.png", texture), (cell / "mesh.glb", out.with_suffix(".glb"))]
    if (cell / "mesh_preview.png").is_file():
        pairs.append((cell / "mesh_preview.png", out.with_suffix(".preview.png")))
    for source, target in pairs:
        with written_whole(target) as temporary:
            shutil.copyfile(source, temporary)
    write_json(out.with_suffix(".json"), notes)
    write_ply(out, mesh, texture.name)
