"""Classify every vertex of a mesh as measured, assumed or unseen; geometry/surface_support.py defines the classes."""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from zeroshop_steps.geometry.meshes import read_ply
from zeroshop_steps.geometry.registered_views import read_views
from zeroshop_steps.geometry.support_classes import MEASURED, compute_area_shares
from zeroshop_steps.geometry.surface_support import classify_surface_support
from zeroshop_steps.runtime.files import atomic_write, write_json
from zeroshop_steps.surface.seeds import read_confirmed_points


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--mesh", type=Path, required=True, help="unwrapped mesh, registration frame")
    parser.add_argument("--cameras", type=Path, required=True, help="registered cameras with images and masks")
    parser.add_argument("--stereo", type=Path, nargs="?", help="seeds.npz with the depths that stereo confirmed, if there are any")
    parser.add_argument("--out", type=Path, required=True, help="evidence.npz; its figures go beside it as .json")


def run(args: argparse.Namespace) -> None:
    """Write the class of every vertex."""
    start_s = time.monotonic()
    mesh = read_ply(args.mesh)
    views, _ = read_views(args.cameras)
    evidence = classify_surface_support(mesh, views, read_confirmed_points(args.stereo, views) if args.stereo else np.zeros((0, 3)))
    shares = compute_area_shares(replace(mesh, quality=evidence / MEASURED))
    with atomic_write(args.out) as temporary:
        np.savez_compressed(temporary, evidence=evidence)
    write_json(args.out.with_suffix(".json"), {"area_shares": shares, "seconds": round(time.monotonic() - start_s, 2)})
    print("evidence: " + ", ".join(f"{share:.1%} {name}" for name, share in shares.items()), file=sys.stderr)
