"""Compare meshes of the same object that were made by different pipelines, pair by pair.

Neither is the truth. Each first mesh is aligned with the second by a similarity, found from shape and print alone, so that neither frame
nor scale matters; how much it had to grow is one of the figures. Distances are from either surface to the other. Where the cameras of
both are given, as COLMAP models, they are compared, too, after an alignment by their centres.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.align import align, measure_residuals
from zeroshop_steps.bop.formats.models import measure_diameter_mm
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model
from zeroshop_steps.geometry.meshes.mesh_files import read_mesh
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.tables import write_table

NAMES = {
    "scale": "scale_to_other",
    "mesh_to_truth_mm": "mesh_to_other_mm",
    "mesh_to_truth_median_mm": "mesh_to_other_median_mm",
    "mesh_to_truth_95_percent_mm": "mesh_to_other_95_percent_mm",
    "truth_to_mesh_median_mm": "other_to_mesh_median_mm",
    "print_likeness": "print_likeness",
}
"""Figures of the alignment with a true model, and what they are called where the other mesh is none."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--meshes", type=Path, nargs="+", required=True, help="meshes, e.g. results/photos/soap/2dgs.ply")
    parser.add_argument("--others", type=Path, nargs="+", required=True, help="a mesh to compare each with, in the same order, in mm")
    parser.add_argument("--cameras", type=Path, nargs="+", default=[], help="COLMAP models of the cameras of the meshes")
    parser.add_argument("--other-cameras", type=Path, nargs="+", default=[], help="those of the others; images are matched by name")
    parser.add_argument("--seed", type=int, default=0, help="seed of the samples on the surfaces (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="CSV to write: mesh, other, measure, value")


def run(args: argparse.Namespace) -> None:
    """Write one table for all pairs."""
    counts = {
        len(args.meshes),
        len(args.others),
        *({len(args.cameras), len(args.other_cameras)} if args.cameras or args.other_cameras else ()),
    }
    if len(counts) > 1:
        raise StepError(f"{len(args.meshes)} meshes and {len(args.others)} others; give a mesh, and cameras if any, of both for every pair")
    rows = []
    for index, (path, other) in enumerate(zip(args.meshes, args.others, strict=True)):
        figures = compare_surfaces(read_mesh(path), read_mesh(other), args.seed)
        if args.cameras:
            figures |= compare_registrations(args.cameras[index], args.other_cameras[index])
        rows += [{"mesh": str(path), "other": str(other), "measure": name, "value": value} for name, value in figures.items()]
        print(f"{path} and {other}: {figures['mesh_to_other_mm']:.2f} mm apart, scale {figures['scale_to_other']:.4f}", file=sys.stderr)
    write_table(args.out, rows)


def compare_surfaces(mesh: Mesh, other: Mesh, seed: int = 0) -> dict[str, float]:
    """How far two surfaces are apart once they are aligned, in the other's unit, and the extents of both along their own axes."""
    fit = align(mesh, other, np.eye(4)[None], seed)
    figures = measure_residuals(mesh, other, fit, measure_diameter_mm(other.vertices), seed)
    found = {name: figures[key] for key, name in NAMES.items()}
    for name, one in (("mesh", mesh), ("other", other)):
        found |= {f"{name}_size_{axis}_mm": round(float(size), 4) for axis, size in zip("xyz", np.ptp(one.vertices, axis=0), strict=True)}
        found[f"{name}_faces"] = len(one.faces)
    return found


def compare_registrations(cameras: Path, others: Path) -> dict[str, float]:
    """How far two registrations of the same images are apart: centres in shares of their spread, and turns in degrees."""
    truth: Sequence = read_sparse_model(others).cameras
    error = compare_cameras(read_sparse_model(cameras).cameras, tuple(truth))
    centres = np.array([camera.centre_in_world for camera in truth])
    spread = float(np.linalg.norm(np.ptp(centres, axis=0)))
    return {
        "images_of_both": len(error.names),
        "centres_apart_share": round(float(error.centre_mm.mean()) / spread, 6),
        "turned_mean_deg": round(float(error.rotation_deg.mean()), 5),
        "focal_ratio": round(error.focal_ratio, 5),
    }
