"""Give the raw mesh its final shape, and find its frame: clean it, measure its height, close it.

Each is a module of its own: clean.py, the methods of the height stage, close.py and frame.py. They pass the mesh on as files hold it, so
that a table of heights measures the very mesh that was closed.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from zeroshop_steps.finish import clean
from zeroshop_steps.finish.closing import close
from zeroshop_steps.finish.frame import make_frame_record
from zeroshop_steps.geometry.cameras.registered_views import View, read_views
from zeroshop_steps.geometry.meshes.mass_properties import count_open_edges
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.runtime.cli import run_method, stage_methods
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import part_of_step
from zeroshop_steps.runtime.files import read_json, write_json

CLEAN, HEIGHT, FRAME = "clean.ply", "height.json", "frame.json"
"""What is written beside closed.ply."""
HEIGHTS = "zeroshop_steps.height"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="raw mesh, registration frame")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with images, masks and sparse points")
    parser.add_argument("--capture", type=Path, required=True, help="capture folder; x should point to the camera of its first photo")
    parser.add_argument("--stereo", type=Path, nargs="?", help="seeds.npz with the depths that stereo confirmed, if there are any")
    parser.add_argument(
        "--generated",
        type=Path,
        nargs="?",
        help="a generated mesh, which proposes the underside and hollows where both are closed; registration frame",
    )
    clean.add_options(parser)
    close.add_options(parser)
    parser.add_argument(
        "--out", type=Path, required=True, help=f"closed.ply; its figures (.json), {CLEAN}, {HEIGHT} and {FRAME} go beside it"
    )
    parser.add_argument(
        "--height",
        nargs=argparse.REMAINDER,
        required=True,
        metavar="METHOD",
        help="of the height stage, and its options; comes last",
    )


def run(args: argparse.Namespace) -> None:
    """Shape one mesh."""
    clean.check_options(args)
    method, *words = args.height or [""]
    if method not in (known := stage_methods(HEIGHTS)):
        raise StepError(f"--height names the method {method or '(none)'}; there are {', '.join(known)}")
    cleaned, height_path = args.out.with_name(CLEAN), args.out.with_name(HEIGHT)
    views, _ = read_views(args.cameras)
    with part_of_step("finish.clean"):
        _clean(args, views, cleaned)
    with part_of_step(f"height.{method}"):
        places = {"mesh": cleaned, "cameras": args.cameras, "capture": args.capture, "stereo": args.stereo, "out": height_path}
        run_method(HEIGHTS, method, [*(word for name, path in places.items() if path for word in (f"--{name}", str(path))), *words])
    start_s, height = time.monotonic(), read_json(height_path)
    with part_of_step("finish.close"):
        options = close.Closing(args.underside, args.holes, args.hollows, args.max_faces)
        generated = read_ply(args.generated) if args.generated else None
        closed, facts = close.close_mesh(read_ply(cleaned), height, views, options, args.stereo, generated)
        write_ply(args.out, closed)
        _write_record(args.out.with_suffix(".json"), facts, start_s)
    with part_of_step("finish.frame"):
        start_s = time.monotonic()
        _write_record(args.out.with_name(FRAME), make_frame_record(read_ply(args.out), views, height, args.capture), start_s)


def _clean(args: argparse.Namespace, views: list[View], out: Path) -> None:
    """Write the cleaned mesh and its figures."""
    start_s, raw = time.monotonic(), read_ply(args.mesh)
    try:
        mesh, dropped = clean.clean_mesh(raw, views, args.max_faces, args.min_part, args.smooth, args.max_hole_edges)
    except StepError as error:
        raise StepError(f"{args.mesh}: {error}") from error.__cause__
    write_ply(out, mesh.with_normals())
    figures = {
        "raw_faces": len(raw.faces),
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices),
        "watertight": count_open_edges(mesh) == 0,
        "dropped_parts": dropped,
        "parameters": {name: getattr(args, name) for name in ("max_faces", "min_part", "smooth", "max_hole_edges")},
    }
    _write_record(out.with_suffix(".json"), figures, start_s)
    print(f"clean: {len(raw.faces)} -> {len(mesh.faces)} faces, dropped {dropped}", file=sys.stderr)


def _write_record(path: Path, content: dict[str, Any], start_s: float) -> None:
    """Write what a part did, with the seconds since it began."""
    write_json(path, content | {"seconds": round(time.monotonic() - start_s, 2)})
