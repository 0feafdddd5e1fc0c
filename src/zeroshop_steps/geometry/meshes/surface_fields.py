"""Values at the vertices of a mesh: smooth them over its edges, and fill in unknown ones."""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import cg

from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

LIGHT_SMOOTHING = 2  # steps that take noise from positions and normals, and bend no print
BROAD_SMOOTHING = 12  # steps; of colours and labels, what is broader belongs to a region, what is finer to one face or photo
LEAST_WEIGHT = 1e-8  # below, a normalised convolution has no known value within reach
TOLERANCE, MOST_ITERATIONS = 1e-4, 2000  # of the conjugate gradients: relative residual to reach, and where to stop without reaching it


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
    """(V, V) adjacency over edges; each vertex is also its own neighbour."""
    a, b, c = mesh.faces.T
    start, end = np.r_[a, b, c, b, c, a], np.r_[b, c, a, a, b, c]
    size = len(mesh.vertices)
    matrix = coo_matrix((np.ones(len(start), np.float32), (start, end)), (size, size)).tocsr()
    matrix.data[:] = 1.0
    return (matrix + diags(np.ones(size, np.float32))).tocsr().astype(np.float32)


def smooth(values: np.ndarray, neighbours: csr_matrix, steps: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Average (V, C) values over neighbours `steps` times; with (V,) or (V, C) weights, by normalised convolution.

    The result is 0 where all weights within reach are 0.
    """
    weights = np.ones((len(values), 1), np.float32) if weights is None else weights.reshape(len(values), -1).astype(np.float32)
    total, norm = values * weights, weights
    degree = np.asarray(neighbours.sum(1)).reshape(-1, 1)
    for _ in range(steps):
        total, norm = neighbours @ total / degree, neighbours @ norm / degree
    return np.where(norm > LEAST_WEIGHT, total / np.maximum(norm, LEAST_WEIGHT), 0.0).astype(np.float32)


def smooth_normals(mesh: Mesh, neighbours: csr_matrix, steps: int) -> np.ndarray:
    """(V, 3) unit vertex normals, averaged over neighbours `steps` times."""
    normals = smooth(mesh.vertex_normals, neighbours, steps)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def fill_harmonically(values: np.ndarray, known: np.ndarray, neighbours: csr_matrix) -> np.ndarray:
    """Fill in (V, C) values where (V,) `known` is False: with the harmonic field over the surface that has the known values.

    Parts without any known vertex get the mean of the known values.
    """
    unknown = ~known
    if not unknown.any():
        return values
    filled = values.astype(float).copy()
    mean = values[known].mean(0) if known.any() else np.full(values.shape[1], 0.5)
    degree = np.asarray(neighbours.sum(1)).reshape(-1)
    # So that parts without any known value do not make the system singular.
    laplacian = (diags(degree * (1.0 + 1e-6)) - neighbours).tocsr()
    system = laplacian[unknown][:, unknown]
    for channel in range(values.shape[1]):
        right = -laplacian[unknown][:, known] @ (filled[known, channel] - mean[channel])
        filled[unknown, channel] = cg(system, right, rtol=TOLERANCE, maxiter=MOST_ITERATIONS)[0] + mean[channel]
    return filled.astype(np.float32)
