"""Copy the mesh of the chosen cell to its final path.

The PLY then names the texture beside it, and each vertex has the property `quality`: 1 measured, 0.5 assumed, 0 never seen. A
robot should grasp where the surface was measured.
"""

import argparse
import shutil
from pathlib import Path

from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.geometry.observation.support_classes import compute_area_shares, with_surface_support
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, read_json, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="mesh.ply of the chosen cell with .png, .glb and .json beside it")
    parser.add_argument("--preview", type=Path, help="the cell's preview")
    parser.add_argument("--quality", type=Path, help="the cell's quality.json, which is copied into the JSON")
    parser.add_argument("--evidence", type=Path, help="the cell's evidence.npz, which becomes the quality of the vertices")
    parser.add_argument("--grade", type=Path, help="the cell's grade.json, which is copied into the JSON")
    parser.add_argument(
        "--out", type=Path, required=True, help="e.g. results/demo/mug/2dgs.ply; .png, .glb, .json and .preview.png are written beside it"
    )


def run(args: argparse.Namespace) -> None:
    """Publish one mesh."""
    publish_product(args.mesh, args.out, args.preview, args.quality, args.grade, args.evidence)


def publish_product(
    mesh_path: Path, out: Path, preview: Path | None = None, quality: Path | None = None, grade: Path | None = None,
    evidence: Path | None = None,
) -> None:  # fmt: skip
    """Write `out` and the files beside it. The PLY is written last: if it exists, everything does.

    Raises:
        StepError: a file of the cell is missing, or the evidence belongs to another mesh.
    """
    parts = {suffix: mesh_path.with_suffix(suffix) for suffix in (".png", ".glb", ".json")}
    for part in [*parts.values(), *([preview] if preview else [])]:
        if not part.is_file():
            raise StepError(f"{part} does not exist; run `finish --method export` (and preview) for this cell first")
    mesh, metadata = read_ply(mesh_path), read_json(parts[".json"])
    if quality:
        metadata["quality"] = read_json(quality)
    if grade:
        metadata["grade"] = read_json(grade)
    if evidence:
        mesh = with_surface_support(mesh, evidence)
        metadata["area_shares"] = compute_area_shares(mesh)
    pairs = [(parts[".png"], out.with_suffix(".png")), (parts[".glb"], out.with_suffix(".glb"))]
    pairs += [(preview, out.with_suffix(".preview.png"))] if preview else []
    for source, target in pairs:
        with atomic_write(target) as temporary:
            shutil.copyfile(source, temporary)
    write_json(out.with_suffix(".json"), metadata)
    write_ply(out, mesh, out.with_suffix(".png").name)
