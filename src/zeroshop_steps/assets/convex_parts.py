"""Convex parts of a mesh for collisions, by approximate convex decomposition (CoACD; Wei et al. 2022)."""

from collections.abc import Callable
from types import ModuleType

import numpy as np

from zeroshop_steps.geometry.meshes.mesh_repair import find_triangles
from zeroshop_steps.geometry.meshes.surface_fields import weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.open3d_loader import o3d

DECOMPOSED_FACES = 2500  # of a simplified mesh: parts follow a concavity to some per cent, whatever the mesh's detail
RESOLUTION, ITERATIONS = 1000, 60  # of CoACD's search; its own defaults take three times as long, for parts that are as many
SLIVER, SLIVER_M3 = 1e-5, 1e-12  # of the mesh's volume, and at all (a cube of 0.1 mm): a smaller part is flat, and simulators refuse it


def load_coacd() -> ModuleType:
    """CoACD. Open3D, imported above, must be loaded before it; after it, it cannot be. Raises StepError where it is missing."""
    try:
        import coacd
    except ImportError:
        raise StepError("coacd is not installed, which convex parts need; run: pip install 'zeroshop[robot]', or: make") from None
    coacd.set_log_level("error")
    return coacd


def split_convex(mesh: Mesh, threshold: float, most_parts: int, seed: int, load: Callable[[], ModuleType] = load_coacd) -> list[Mesh]:
    """Convex parts whose union follows the mesh, the largest first.

    Args:
        mesh: closed, in metres.
        threshold: concavity that a part may keep, as a share of the object's size; 0.01 follows closely, 1 gives the convex hull.
        most_parts: at most so many.
        seed: of the search.
        load: gives the library.
    """
    vertices, faces = _simplify(mesh)
    coacd = load()
    found = coacd.run_coacd(
        coacd.Mesh(vertices, faces),
        threshold=threshold,
        max_convex_hull=most_parts,
        resolution=RESOLUTION,
        mcts_iterations=ITERATIONS,
        # What PhysX takes for a convex mesh.
        max_ch_vertex=64,
        decimate=True,
        seed=seed,
    )
    parts = sorted([_hull(np.asarray(corners, float)) for corners, _ in found], key=lambda part: -measure_volume(part))
    least_m3 = max(SLIVER * measure_volume(mesh), SLIVER_M3)
    return [part for part in parts if measure_volume(part) > least_m3] or parts[:1]


def _simplify(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) vertices and (F, 3) faces of a simpler mesh; texture seams are joined."""
    joined = weld(mesh)[0]
    places, faces = joined.vertices, joined.faces[find_triangles(joined.faces)]
    if len(faces) <= DECOMPOSED_FACES:
        return places, faces
    whole = o3d.t.geometry.TriangleMesh(o3d.core.Tensor(places.astype(np.float32)), o3d.core.Tensor(faces.astype(np.int32)))
    simple = whole.simplify_quadric_decimation(1 - DECOMPOSED_FACES / len(faces))
    return simple.vertex.positions.numpy().astype(float), simple.triangle.indices.numpy().astype(int)


def _hull(corners: np.ndarray) -> Mesh:
    """The convex hull of (N, 3) points, faces counter-clockwise from outside."""
    import trimesh

    with np.errstate(divide="ignore", invalid="ignore"):  # flat parts have no centre of mass
        hull = trimesh.convex.convex_hull(corners)
    return Mesh(np.asarray(hull.vertices, float), np.asarray(hull.faces, np.int64))


def measure_volume(part: Mesh) -> float:
    """What a closed mesh encloses, also one that is flat."""
    corners = part.vertices[part.faces]
    return float(np.einsum("nd,nd->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6)
