"""Small pictures for the pages, and the thumbnail of an object."""

from pathlib import Path

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.viewpoints import place_around
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.report.site.results_index import Run
from zeroshop_steps.report.site.viewer_data import VIEW_PX, encode_webp
from zeroshop_steps.report.site.viewer_meshes import TrueModel
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.files import atomic_write

FRONT = np.array([1.0, -0.55, 0.45])
"""Towards the camera, in the frame of the mesh: a little from the right and from above, so that three sides show."""


def write_webp(path: Path, image: np.ndarray) -> None:
    """Write (height, width, 3 or 4) uint8 RGB or RGBA as WebP."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(encode_webp(image))


def render_thumbnail(runs: list[Run], truth: TrueModel | None) -> np.ndarray | None:
    """(320, 320, 4) uint8 RGBA of the first finished mesh, otherwise of the true model; None if there is neither."""
    mesh = _read_first_whole([cell.folder / "mesh.ply" for run in runs for cell in run.cells if cell.state == "done"])
    mesh = mesh or (truth.mesh if truth else None)
    if mesh is None:
        return None
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    camera = place_around((low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-9), FRONT, VIEW_PX)
    color, coverage = MeshRenderer(mesh).render_cut_out(camera)
    return np.dstack([color, coverage])


def _read_first_whole(paths: list[Path]) -> Mesh | None:
    for path in paths:
        try:
            return read_ply(path)
        except StepError as error:
            warn(f"no picture of a damaged mesh: {error}")
    return None


def fit_width(image: np.ndarray, width_px: int) -> np.ndarray:
    """The image, shrunk to a width of at most `width_px`."""
    if image.shape[1] <= width_px:
        return image
    return cv2.resize(image, (width_px, max(1, round(image.shape[0] * width_px / image.shape[1]))), interpolation=cv2.INTER_AREA)
