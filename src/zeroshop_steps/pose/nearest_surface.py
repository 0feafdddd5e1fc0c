"""The nearest point of a model's surface, looked up in a table of cells: what makes thousands of ICP steps cheap.

Fitzgibbon (Robust registration of 2D and 3D point sets, 2003) keeps distances in such a table; this one keeps which sample
of the surface is nearest, so that its normal is known, too.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.meshes import Mesh
from zeroshop_steps.geometry.surface_points import sample_surface_points

SAMPLES = 16000
CELLS = 160_000
MARGIN_DIAMETERS = 0.25
OPEN_SHARE = 0.05


@dataclass(frozen=True)
class NearestSurface:
    """A model's surface, ready for look-ups.

    Attributes:
        points, normals: (S, 3) samples, mm, model frame; any first part of them is spread as evenly as all.
        is_open: whether so much of the surface is only assumed that the model may be hollow and be seen from inside; then the assumed
            part has no samples.
        low: (3,) corner of the table.
        cell_mm: side of its cells.
        table: (nx, ny, nz) int32, the sample nearest to the middle of each cell; what lies outside is looked up at the border.
    """

    points: np.ndarray
    normals: np.ndarray
    is_open: bool
    low: np.ndarray
    cell_mm: float
    table: np.ndarray


def build_nearest_surface(mesh: Mesh, diameter_mm: float) -> NearestSurface:
    """Make the table of a model."""
    assumed = mesh.assumed_faces()
    areas = mesh.face_areas()
    is_open = bool(areas[assumed].sum() > OPEN_SHARE * areas.sum())
    measured = Mesh(mesh.vertices, mesh.faces[~assumed]) if is_open else mesh
    samples = sample_surface_points(measured, SAMPLES, np.random.default_rng(0))
    margin_mm = MARGIN_DIAMETERS * diameter_mm
    low = mesh.vertices.min(0) - margin_mm
    size = mesh.vertices.max(0) + margin_mm - low
    cell_mm = float(np.cbrt(size.prod() / CELLS))
    axes = [low[axis] + cell_mm * (np.arange(int(np.ceil(size[axis] / cell_mm))) + 0.5) for axis in range(3)]
    middles = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    _, nearest = cKDTree(samples.points).query(middles.reshape(-1, 3))
    points, normals = (np.ascontiguousarray(values, np.float64) for values in (samples.points, samples.normals))
    return NearestSurface(points, normals, is_open, low, cell_mm, nearest.astype(np.int32).reshape(middles.shape[:3]))
