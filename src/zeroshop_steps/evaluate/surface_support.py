"""Classify every vertex of a mesh as measured, assumed or unseen; geometry/surface_support.py defines the classes."""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.ply_surface import read_ply
from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.geometry.support_classes import MEASURED, UNSEEN, compute_area_shares
from zeroshop_steps.geometry.surface_support import classify_surface_support
from zeroshop_steps.runtime.files import atomic_write, read_json, write_json
from zeroshop_steps.runtime.kernel_devices import DEVICES, choose_kernel_device
from zeroshop_steps.surface.seeds import read_confirmed_points


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="unwrapped mesh, registration frame")
    parser.add_argument("--cameras", type=Path, help="registered cameras with images and masks; without any, nothing was seen")
    parser.add_argument("--stereo", type=Path, nargs="?", help="seeds.npz with the depths that stereo confirmed, if there are any")
    parser.add_argument("--closing", type=Path, help="closed.json: what a generated mesh proposed is never seen, whatever photos show")
    parser.add_argument("--device", choices=DEVICES, default="cpu", help="where the mesh is rasterized (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="evidence.npz; its figures go beside it as .json")


def run(args: argparse.Namespace) -> None:
    """Write the class of every vertex."""
    start_s, device = time.monotonic(), choose_kernel_device(args.device)
    mesh = read_ply(args.mesh)
    if args.cameras is None:
        evidence = np.full(len(mesh.vertices), UNSEEN, np.uint8)
    else:
        views, _ = read_views(args.cameras)
        confirmed = read_confirmed_points(args.stereo, views) if args.stereo else np.zeros((0, 3))
        evidence = classify_surface_support(mesh, views, confirmed, device)
    if args.closing:
        evidence = drop_generated(evidence, mesh, read_json(args.closing))
    shares = compute_area_shares(replace(mesh, quality=evidence / MEASURED))
    with atomic_write(args.out) as temporary:
        np.savez_compressed(temporary, evidence=evidence)
    write_json(args.out.with_suffix(".json"), {"area_shares": shares, "device": device, "seconds": round(time.monotonic() - start_s, 2)})
    print("evidence: " + ", ".join(f"{share:.1%} {name}" for name, share in shares.items()), file=sys.stderr)


def drop_generated(evidence: np.ndarray, mesh: Mesh, closing: dict[str, Any]) -> np.ndarray:
    """(V,) the classes, with vertices that only generated faces have, which are the mesh's last ones, as never seen."""
    if closing["closing"]["method"] != "generated":
        return evidence
    kept = np.zeros(len(mesh.vertices), bool)
    kept[mesh.faces[: closing["underside"]["first_face"]]] = True
    return np.where(kept, evidence, UNSEEN).astype(np.uint8)
