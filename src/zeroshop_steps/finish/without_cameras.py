"""Finish a mesh that was generated without cameras: clean it, unwrap it, and bake the colours of its vertices into a texture.

Nothing of such a mesh was measured, so all of its faces are marked as never seen. It is upright as generated, x as generated, and as
high as the user says; without a height, its scale is unknown.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.finish.clean import add_options, check_options, clean_mesh
from zeroshop_steps.finish.closing.underside import STATES, Underside, find_open_borders
from zeroshop_steps.finish.export import make_metadata, move_to_object_frame, summarize_product, write_product
from zeroshop_steps.finish.texture import bake_colors, read_colored
from zeroshop_steps.finish.texturing.unwrap import check_texture_size, unwrap_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.height.record import RULER_M
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import read_json

FRAME_TEXT = "origin at the bounding-box centre, z up and x as generated, right-handed"
GUESS = "the mesh was generated without cameras: nothing of it was measured, and its proportions are a guess"
UNKNOWN = "the scale is unknown: no height is given. Give the object's height in metres as height_m in config/objects.tsv"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="coloured raw mesh, generated without cameras, with its JSON beside it")
    add_options(parser)
    parser.add_argument("--holes", choices=STATES, default="closed", help="close all other holes, too (default: %(default)s)")
    parser.add_argument("--texture-size", type=int, default=2048, help="side of the square texture in texels (default: %(default)s)")
    parser.add_argument("--stages", type=Path, nargs="*", default=[], help="JSONs of earlier steps, whose seconds are copied")
    parser.add_argument("--out", type=Path, required=True, help="mesh.ply; .png, .glb and .json are written beside it")


def run(args: argparse.Namespace) -> None:
    """Finish one generated mesh."""
    check_texture_size(args.texture_size)
    check_options(args)
    start_s = time.monotonic()
    record = read_generated_record(args.mesh.with_suffix(".json"))
    raw = read_colored(args.mesh)
    hole_edges = len(raw.faces) if args.holes == "closed" else args.max_hole_edges
    try:
        cleaned, dropped = clean_mesh(raw, [], args.max_faces, args.min_part, args.smooth, hole_edges)
    except StepError as error:
        raise StepError(f"{args.mesh}: {error}") from error.__cause__
    mesh, charts = unwrap_mesh(cleaned.with_normals(), args.texture_size)
    texture = bake_colors(mesh, raw, args.texture_size)
    frame = make_frame(cleaned, record["height_m"])
    product = move_to_object_frame(mesh, np.array(frame["object_from_registration"]), texture)
    options = ("max_faces", "min_part", "smooth", "max_hole_edges", "holes", "texture_size")
    stages = {path.stem: read_json(path) for path in args.stages} | {
        "raw_mesh": record,
        "closed": mark_as_unseen(cleaned),
        "without_cameras": {
            "seconds": round(time.monotonic() - start_s, 2),
            "parameters": {name: getattr(args, name) for name in options},
        },
    }
    facts = make_metadata(product, frame, stages) | {"frame": FRAME_TEXT, "generated": True, "charts": charts, "dropped_parts": dropped}
    write_product(args.out, product, facts)
    for text in frame["warnings"]:
        warn(text)
    print(f"without_cameras: {args.out} {summarize_product(product, frame)}", file=sys.stderr)


def read_generated_record(path: Path) -> dict[str, Any]:
    """The JSON of a raw mesh. Raises StepError where that mesh was measured, or generated in the frame of cameras."""
    record: dict[str, Any] = read_json(path)
    if not record.get("generated") or "height_m" not in record:
        raise StepError(
            f"{path} is not of a mesh that was generated without cameras (generated, height_m); finish a mesh with cameras by shape and"
            " texture, or make one without by trellis with --capture"
        )
    return record


def mark_as_unseen(mesh: Mesh) -> dict[str, Any]:
    """What closed.json says of other meshes: here, all faces are a guess and never seen."""
    left = len(find_open_borders(mesh.faces))
    unseen = Underside("open" if left else "closed", 0, len(mesh.faces), 0, left, not left)
    return {"underside": unseen.as_record(), "closing": {"method": "generated", "watertight": not left}}


def make_frame(mesh: Mesh, height_m: float | None) -> dict[str, Any]:
    """The content of frame.json of other meshes, for a cleaned mesh that stands upright; its own frame is called the registration's.

    Args:
        mesh: z up, in any unit.
        height_m: how high the object is; None leaves the mesh as large as it is.
    """
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    extent = float(high[2] - low[2])
    scale = 1.0 if height_m is None else MM_PER_M * height_m / extent
    similarity = np.diag([scale, scale, scale, 1.0])
    similarity[:3, 3] = -scale * (low + high) / 2
    return {
        "object_from_registration": similarity.tolist(),
        "up_source": "generated",
        "scale_source": "unknown" if height_m is None else "known_height",
        "scale": "unknown" if height_m is None else "known",
        "height_m": height_m,
        "height_deviation_m": None if height_m is None else RULER_M,
        "height_measured_from": "the surface's bottom to its top",
        "height_in_registration": extent,
        "unit": "registration" if height_m is None else "mm",
        "bottom_z": -scale * extent / 2,
        "first_camera": None,
        "warnings": [GUESS] + ([UNKNOWN] if height_m is None else []),
    }
