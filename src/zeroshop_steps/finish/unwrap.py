"""Unwrap the surface into a texture atlas with xatlas; vertices are split where a seam runs."""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import xatlas

from zeroshop_steps.errors import StepError
from zeroshop_steps.files import write_json
from zeroshop_steps.meshes import Mesh, read_ply, write_ply

PADDING_TEXELS = 6


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method\'s command line."""
    parser.add_argument("--mesh", type=Path, required=True)
    parser.add_argument("--texture-size", type=int, default=2048, help="side of the square texture in texels")
    parser.add_argument("--out", type=Path, required=True, help="mesh with texture_u and texture_v; its figures go beside it as .json")


def run(args: argparse.Namespace) -> None:
    check_texture_size(args.texture_size)
    start_s = time.monotonic()
    mesh, charts = unwrap_mesh(read_ply(args.mesh), args.texture_size)
    write_ply(args.out, mesh)
    figures = {"charts": charts, "vertices": len(mesh.vertices), "atlas_use": round(atlas_use(mesh), 4)}
    figures |= {"parameters": {"texture_size": args.texture_size}, "seconds": round(time.monotonic() - start_s, 2)}
    write_json(args.out.with_suffix(".json"), figures)
    print(f"unwrap: {charts} charts, {figures['atlas_use']:.0%} of the texture used, {figures['seconds']} s", file=sys.stderr)


def check_texture_size(texture_size: int) -> None:
    """Raise StepError for a texture size outside 64 to 8192."""
    if not 64 <= texture_size <= 8192:
        raise StepError(f"--texture-size is {texture_size}; expected 64 to 8192 texels")


def unwrap_mesh(mesh: Mesh, texture_size: int) -> tuple[Mesh, int]:
    """Unwrap into one square atlas.

    Returns:
        mesh: seam-split mesh with `uv` in [0, 1] and normals that are shared across seams.
        charts: number of charts.
    """
    mesh = mesh.with_normals()
    extent = np.ptp(mesh.vertices, axis=0).max()
    atlas = xatlas.Atlas()
    atlas.add_mesh(
        ((mesh.vertices - mesh.vertices.min(0)) / extent).astype(np.float32), mesh.faces.astype(np.uint32), mesh.normals.astype(np.float32)
    )
    charts = xatlas.ChartOptions()
    charts.max_cost = 8.0  # grow large charts: every seam is a place where print can break
    charts.normal_seam_weight = 1.0
    charts.max_iterations = 1
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding = texture_size, PADDING_TEXELS
    pack.bilinear, pack.bruteForce = True, False
    atlas.generate(charts, pack)
    if atlas.atlas_count < 1:
        raise StepError("the mesh could not be unwrapped: it has no face with an area; clean it first")
    source, faces, uv = atlas.get_mesh(0)
    longest = max(atlas.width, atlas.height)  # xatlas scales each axis to [0, 1]; keep texels square
    uv = uv.astype(float) * np.array([atlas.width, atlas.height]) / longest
    return Mesh(mesh.vertices[source], faces.astype(np.int64), mesh.normals[source], uv), atlas.chart_count


def atlas_use(mesh: Mesh) -> float:
    """Share of the texture that triangles cover."""
    a, b, c = (mesh.uv[mesh.faces[:, corner]] for corner in range(3))
    return float(np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2)
