"""Smooth triangle meshes."""

import numpy as np
from scipy.sparse import csr_matrix, diags

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

TAUBIN_LAMBDA, TAUBIN_MU = 0.5, -0.53  # a step that shrinks, then one that grows a little more


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
