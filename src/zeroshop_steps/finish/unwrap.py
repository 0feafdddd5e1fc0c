"""Unwrap the surface into a texture atlas: cut it into charts, pack them with xatlas; vertices are split where a seam runs."""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import xatlas

from zeroshop_steps.finish.charts import cut_into_charts
from zeroshop_steps.geometry.meshes import Mesh, read_ply, write_ply
from zeroshop_steps.geometry.surface_fields import weld
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import write_json

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
    figures = {"charts": charts, "vertices": len(mesh.vertices), "atlas_use": round(measure_atlas_use(mesh), 4)}
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
    mesh, _ = weld(mesh)
    chart, flat = cut_into_charts(mesh)
    # one vertex for each pair of place and chart
    keys, split = np.unique(chart[:, None] * len(mesh.vertices) + mesh.faces, return_inverse=True)
    faces, place = split.reshape(-1, 3), keys % len(mesh.vertices)
    uv = np.zeros((len(keys), 2))
    uv[faces.reshape(-1)] = flat.reshape(-1, 2)
    atlas = _pack_charts(uv, faces, chart, texture_size)
    source, packed_faces, packed_uv = atlas.get_mesh(0)
    longest = max(atlas.width, atlas.height)  # xatlas scales each axis to [0, 1]; keep texels square
    packed_uv = packed_uv.astype(float) * np.array([atlas.width, atlas.height]) / longest
    faces, place, packed_uv = _collapse_stretched(packed_faces.astype(np.int64), place[source], packed_uv, flat)
    return Mesh(mesh.vertices[place], faces, mesh.normals[place], packed_uv), int(chart.max()) + 1


def _collapse_stretched(
    faces: np.ndarray, place: np.ndarray, uv: np.ndarray, flat: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shrink faces to a point of the atlas that packing did not move as a whole: xatlas leaves faces without area where they were.

    Such a face would run across other charts; it is a line in its own, so one colour is enough for it.
    """
    lengths, wanted = (np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2) for corners in (uv[faces], flat))
    density = np.median(lengths[wanted > 0] / wanted[wanted > 0])
    bad = (lengths > 1.2 * density * wanted + 1e-3).any(1)
    sound = np.zeros(len(place), bool)
    sound[faces[~bad]] = True
    anchor = np.where(sound[faces[bad]], faces[bad], -1).max(1)
    anchor = np.where(anchor < 0, faces[bad][:, 0], anchor)
    fresh = len(place) + np.arange(3 * len(anchor))
    place, uv = np.r_[place, place[faces[bad].reshape(-1)]], np.concatenate([uv, np.repeat(uv[anchor], 3, axis=0)])
    faces = faces.copy()
    faces[bad] = fresh.reshape(-1, 3)
    used, index = np.unique(faces, return_inverse=True)
    return index.reshape(faces.shape), place[used], uv[used]


def _pack_charts(uv: np.ndarray, faces: np.ndarray, chart: np.ndarray, texture_size: int) -> xatlas.Atlas:
    """Pack charts so that the longer side of the atlas comes out close to `texture_size` texels, which keeps the padding as asked."""
    a, b, c = (uv[faces[:, corner]] for corner in range(3))
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    if area <= 0:
        raise StepError("the mesh could not be unwrapped: it has no face with an area; clean it first")
    density = texture_size * np.sqrt(0.6 / area)
    for _ in range(3):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh((uv * density).astype(np.float32), faces.astype(np.uint32), chart.astype(np.uint32)[:, None])
        pack = xatlas.PackOptions()
        pack.resolution, pack.texels_per_unit, pack.padding = 0, 1.0, PADDING_TEXELS  # one page, however large
        pack.bilinear, pack.bruteForce = True, False
        pack.rotate_charts = False  # xatlas turns charts by swapping u and v, which mirrors the print
        atlas.generate(xatlas.ChartOptions(), pack)
        ratio = texture_size / max(atlas.width, atlas.height)
        if 0.97 < ratio < 1.1:
            break
        density *= 0.98 * ratio
    return atlas


def measure_atlas_use(mesh: Mesh) -> float:
    """Share of the texture that triangles cover."""
    a, b, c = (mesh.uv[mesh.faces[:, corner]] for corner in range(3))
    return float(np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2)
