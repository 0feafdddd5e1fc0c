"""Values on the vertices of a mesh: smoothing over its edges and filling where nothing is known."""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import cg

from zeroshop_steps.geometry.meshes import Mesh


def weld(mesh: Mesh) -> tuple[Mesh, np.ndarray]:
    """Join vertices of equal position, which texture seams split.

    Returns:
        mesh: positions, faces and area-weighted normals.
        index: (V,) welded vertex of each vertex of `mesh`.
    """
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    index = index.reshape(-1)
    return Mesh(vertices, index[mesh.faces]).with_normals(), index


def build_neighbour_matrix(mesh: Mesh) -> csr_matrix:
    """(V, V) adjacency over edges, each vertex its own neighbour too."""
    a, b, c = mesh.faces.T
    start, end = np.r_[a, b, c, b, c, a], np.r_[b, c, a, a, b, c]
    size = len(mesh.vertices)
    matrix = coo_matrix((np.ones(len(start), np.float32), (start, end)), (size, size)).tocsr()
    matrix.data[:] = 1.0
    return (matrix + diags(np.ones(size, np.float32))).tocsr().astype(np.float32)


def smooth(values: np.ndarray, neighbours: csr_matrix, steps: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Average (V, C) values over neighbours `steps` times; with (V,) or (V, C) weights, by normalised convolution.

    Where no weight is near, the result is 0.
    """
    weights = np.ones((len(values), 1), np.float32) if weights is None else weights.reshape(len(values), -1).astype(np.float32)
    total, norm = values * weights, weights
    degree = np.asarray(neighbours.sum(1)).reshape(-1, 1)
    for _ in range(steps):
        total, norm = neighbours @ total / degree, neighbours @ norm / degree
    return np.where(norm > 1e-8, total / np.maximum(norm, 1e-8), 0.0).astype(np.float32)


def fill_harmonically(values: np.ndarray, known: np.ndarray, neighbours: csr_matrix) -> np.ndarray:
    """Fill (V, C) values where (V,) `known` is False with the smoothest surface field through the known ones.

    Parts without any known vertex get the mean of the known values.
    """
    unknown = ~known
    if not unknown.any():
        return values
    filled = values.astype(float).copy()
    mean = values[known].mean(0) if known.any() else np.full(values.shape[1], 0.5)
    degree = np.asarray(neighbours.sum(1)).reshape(-1)
    laplacian = (diags(degree * (1.0 + 1e-6)) - neighbours).tocsr()
    system = laplacian[unknown][:, unknown]
    for channel in range(values.shape[1]):
        right = -laplacian[unknown][:, known] @ (filled[known, channel] - mean[channel])
        filled[unknown, channel] = cg(system, right, rtol=1e-4, maxiter=2000)[0] + mean[channel]
    return filled.astype(np.float32)
