"""Unwrap the surface into a texture atlas: cut it into charts and pack them with xatlas. Vertices are split along the seams."""

import numpy as np
import xatlas

from zeroshop_steps.finish.texturing.charts import cut_into_charts
from zeroshop_steps.geometry.meshes.surface_fields import weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError

PADDING_TEXELS = 6  # between charts: texture filtering, also in coarser mip levels, must not reach a neighbouring chart
TEXTURE_SIZES = (64, 8192)  # texels; smaller ones show no print, larger ones few viewers load
ATLAS_FILL = 0.6  # share of the square that charts are expected to cover, for the first guess of the density
PACK_ROUNDS = 3  # the density is corrected until the atlas's size is within PACKED_SIZE of the asked one
PACKED_SIZE, SAFETY = (0.97, 1.1), 0.98
STRETCHED, STRETCH_SLACK = 1.2, 1e-3  # an edge this much longer in the atlas than its chart's scale says was not moved with its chart


def check_texture_size(texture_size: int) -> None:
    """Raise StepError for a texture size out of range."""
    smallest, largest = TEXTURE_SIZES
    if not smallest <= texture_size <= largest:
        raise StepError(f"--texture-size is {texture_size}; expected {smallest} to {largest} texels")


def unwrap_mesh(mesh: Mesh, texture_size: int) -> tuple[Mesh, int]:
    """Unwrap into one square atlas.

    Returns:
        mesh: split along the seams, with `uv` in [0, 1] and the same normals on both sides of a seam.
        charts: number of charts.
    """
    mesh, _ = weld(mesh)
    chart, flat = cut_into_charts(mesh)
    # One vertex for each pair of position and chart.
    keys, split = np.unique(chart[:, None] * len(mesh.vertices) + mesh.faces, return_inverse=True)
    faces, place = split.reshape(-1, 3), keys % len(mesh.vertices)
    uv = np.zeros((len(keys), 2))
    uv[faces.reshape(-1)] = flat.reshape(-1, 2)
    atlas = _pack_charts(uv, faces, chart, texture_size)
    source, packed_faces, packed_uv = atlas.get_mesh(0)
    longest = max(atlas.width, atlas.height)  # xatlas scales each axis to [0, 1]; this keeps texels square
    packed_uv = packed_uv.astype(float) * np.array([atlas.width, atlas.height]) / longest
    faces, place, packed_uv = _collapse_stretched(packed_faces.astype(np.int64), place[source], packed_uv, flat)
    uv = packed_uv.astype(np.float32).astype(float)  # as files hold them: the texture is baked for the very places
    return Mesh(mesh.vertices[place], faces, mesh.vertex_normals[place], uv), int(chart.max()) + 1


def _collapse_stretched(
    faces: np.ndarray, place: np.ndarray, uv: np.ndarray, flat: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shrink faces to a point of the atlas if packing did not move all of their corners: xatlas leaves faces without area in place.

    Such a face would lie across other charts. In its own chart it is a line, so one colour is enough.
    """
    lengths, wanted = (np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2) for corners in (uv[faces], flat))
    density = np.median(lengths[wanted > 0] / wanted[wanted > 0])
    bad = (lengths > STRETCHED * density * wanted + STRETCH_SLACK).any(1)
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
    """Pack the charts so that the longer side of the atlas is close to `texture_size` texels; then the padding is as asked."""
    a, b, c = (uv[faces[:, corner]] for corner in range(3))
    area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    if area <= 0:
        raise StepError("the mesh could not be unwrapped: it has no face with an area; clean it first")
    density = texture_size * np.sqrt(ATLAS_FILL / area)
    for _ in range(PACK_ROUNDS):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh((uv * density).astype(np.float32), faces.astype(np.uint32), chart.astype(np.uint32)[:, None])
        pack = xatlas.PackOptions()
        pack.resolution, pack.texels_per_unit, pack.padding = 0, 1.0, PADDING_TEXELS  # one page, however large
        pack.bilinear, pack.bruteForce = True, False
        pack.rotate_charts = False  # xatlas rotates charts by swapping u and v, which mirrors the print
        atlas.generate(xatlas.ChartOptions(), pack)
        ratio = texture_size / max(atlas.width, atlas.height)
        if PACKED_SIZE[0] < ratio < PACKED_SIZE[1]:
            break
        density *= SAFETY * ratio
    return atlas


def measure_atlas_use(mesh: Mesh) -> float:
    """Share of the texture that triangles cover."""
    uv = mesh.texture_coordinates
    a, b, c = (uv[mesh.faces[:, corner]] for corner in range(3))
    return float(np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2)
