"""The nearest point of a model's surface, looked up in a table of cells, which makes thousands of ICP steps cheap.

Fitzgibbon (Robust registration of 2D and 3D point sets, 2003) stores distances in such a table. This one stores the index of the
nearest sample of the surface, which gives its normal as well.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from zeroshop_steps.geometry.alignment.surface_points import SurfacePoints, sample_surface_points
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.open3d_loader import o3d, ray_caster

FEW_SAMPLES = 2000  # of the surface, for means over it
SAMPLES = 16000  # of the surface; about 2 mm apart on an object of 15 cm
CELLS = 160_000  # of the table, about 0.6 MB; a look-up is off by at most about a cell's diagonal
MARGIN_DIAMETERS = 0.25  # of the table around the model's box; points farther away are looked up at its border
OPEN_SHARE = 0.05  # of the surface: if more is only assumed, the model may be hollow; less is noise of the classes
THIN_SHARE = 0.5  # of the surface: if the walls behind more of it are thinner than a cell, both of their sides are one to the table


class NearestSurface(NamedTuple):
    """Samples of a model's surface and a table that finds the nearest one; a tuple, as kernels take it.

    Attributes:
        points, normals: (S, 3) samples, mm, model frame; the first K of them are spread as evenly as all.
        is_open: whether a point may belong to a surface that faces away: so much of the surface is only assumed that the model may be
            hollow and seen from inside, and then the assumed part has no samples; or its walls are too thin to tell their sides apart.
        low: (3,) lower corner of the table, mm.
        cell_mm: side of its cells.
        table: (nx, ny, nz) int32 index of the sample nearest to the centre of each cell.
    """

    points: np.ndarray
    normals: np.ndarray
    is_open: bool
    low: np.ndarray
    cell_mm: float
    table: np.ndarray


def build_nearest_surface(mesh: Mesh, diameter_mm: float) -> NearestSurface:
    """Sample a model's surface and build its table."""
    assumed = mesh.assumed_faces()
    areas = mesh.face_areas()
    is_open = bool(areas[assumed].sum() > OPEN_SHARE * areas.sum())
    measured = Mesh(mesh.vertices, mesh.faces[~assumed]) if is_open else mesh
    samples = sample_surface_points(measured, SAMPLES, np.random.default_rng(0))
    margin_mm = MARGIN_DIAMETERS * diameter_mm
    low = mesh.vertices.min(0) - margin_mm
    size = mesh.vertices.max(0) + margin_mm - low
    cell_mm = float(np.cbrt(size.prod() / CELLS))
    is_open = is_open or _measure_thin_share(mesh, samples, cell_mm) > THIN_SHARE
    axes = [low[axis] + cell_mm * (np.arange(int(np.ceil(size[axis] / cell_mm))) + 0.5) for axis in range(3)]
    middles = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    _, nearest = cKDTree(samples.points).query(middles.reshape(-1, 3))
    points, normals = (np.ascontiguousarray(values, np.float64) for values in (samples.points, samples.normals))
    return NearestSurface(points, normals, is_open, low, cell_mm, nearest.astype(np.int32).reshape(middles.shape[:3]))


def _measure_thin_share(mesh: Mesh, samples: SurfacePoints, thin_mm: float) -> float:
    """Share of the surface behind which the next surface is nearer than `thin_mm`, as in a bowl or a sheet."""
    starts = samples.points - 1e-3 * samples.normals
    rays = np.concatenate([starts, -samples.normals], 1).astype(np.float32)
    behind_mm = ray_caster((mesh.vertices, mesh.faces)).cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return float((behind_mm < thin_mm).mean())
