"""Smooth and simplify triangle meshes."""

import numpy as np
from scipy.sparse import csr_matrix, diags

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

TAUBIN_LAMBDA, TAUBIN_MU = 0.5, -0.53  # a step that shrinks, then one that grows a little more
COLLAPSE_SPEEDS = (3.0, 5.0, 7.0, 9.0)
"""How fast the error at which edges collapse grows, the first that leaves few enough faces. At the library's default of 7, slivers
and edges of three faces are frequent."""


def smooth_taubin(mesh: Mesh, steps: int) -> Mesh:
    """The mesh after `steps` pairs of Taubin's smoothing (SIGGRAPH 1995), which does not shrink; neighbours count alike.

    A vertex on an open border moves towards its neighbours on the border alone, so that borders do not creep inwards.
    """
    average, isolated = _average_neighbors(mesh)
    vertices = mesh.vertices.astype(float)
    for _ in range(steps):
        for share in (TAUBIN_LAMBDA, TAUBIN_MU):
            vertices = vertices + share * np.where(isolated[:, None], 0.0, average @ vertices - vertices)
    return Mesh(vertices, mesh.faces)


def _average_neighbors(mesh: Mesh) -> tuple[csr_matrix, np.ndarray]:
    """The (V, V) matrix that averages the neighbours of each vertex, and (V,) bool for vertices without any."""
    size = len(mesh.vertices)
    one, other = mesh.faces.ravel(), np.roll(mesh.faces, -1, 1).ravel()
    ones = np.ones(len(one), np.int32)
    count = csr_matrix((ones, (one, other)), (size, size))
    count = (count + count.T).tocoo()  # of the faces at each edge
    border = np.zeros(size, bool)
    border[count.row[count.data == 1]] = True
    counted = ~border[count.row] | (count.data == 1)
    neighbors = csr_matrix((np.ones(counted.sum()), (count.row[counted], count.col[counted])), (size, size))
    degree = np.asarray(neighbors.sum(1)).ravel()
    return diags(1.0 / np.maximum(degree, 1.0)) @ neighbors, degree == 0


def decimate(mesh: Mesh, max_faces: int) -> Mesh:
    """At most `max_faces` faces, by quadric edge collapse (Garland and Heckbert, SIGGRAPH 1997); it may change the topology."""
    if len(mesh.faces) <= max_faces:
        return mesh
    import fast_simplification

    # The library's errors are absolute.
    middle, size = mesh.vertices.mean(0), float(np.ptp(mesh.vertices, axis=0).max())
    vertices, faces = (mesh.vertices - middle) / size, mesh.faces.astype(np.int32)
    for speed in COLLAPSE_SPEEDS:
        vertices, faces = fast_simplification.simplify(vertices, faces, target_count=max_faces, agg=speed)
        if len(faces) <= max_faces:
            break
    return Mesh(np.asarray(vertices, float) * size + middle, np.asarray(faces, np.int64))
