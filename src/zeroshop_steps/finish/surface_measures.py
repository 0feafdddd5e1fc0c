"""What a mesh alone tells about its quality: in one part, closed, smooth."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

from zeroshop_steps.finish.clean import part_labels
from zeroshop_steps.finish.surface_error import sampled
from zeroshop_steps.finish.surface_fields import welded
from zeroshop_steps.meshes import Mesh

UNDERSIDE_DIAMETERS = 0.05  # a border this near to the support is the rim of the side that no photo shows
ROUGHNESS_DIAMETERS = 0.02  # roughness is what normals vary by within this distance
SAMPLES = 20_000
LEAST_NEIGHBOURS = 4


def diameter_of(mesh: Mesh) -> float:
    """Diagonal of the bounding box: the length that relative measures refer to, in the mesh's unit."""
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def largest_part_share(mesh: Mesh) -> float:
    """Area of the largest connected part, as a share of the whole; vertices of equal position are joined."""
    joined, _ = welded(mesh)
    areas = np.bincount(part_labels(joined), joined.as_trimesh().area_faces)
    return float(areas.max() / max(areas.sum(), 1e-30))


def open_boundary(mesh: Mesh, support_z: float | None) -> float:
    """Length of the edges that only one face has, in diameters; those near the unseen underside do not count.

    Args:
        mesh: object frame, z up.
        support_z: height of the support, whose rim is left out; None where photos show the underside.
    """
    joined, _ = welded(mesh)
    edges = np.sort(joined.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    ends = joined.vertices[unique[count == 1]]
    diameter = diameter_of(joined)
    if support_z is not None:
        ends = ends[ends[:, :, 2].mean(1) > support_z + UNDERSIDE_DIAMETERS * diameter]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum() / diameter)


def roughness_deg(mesh: Mesh, seed: int = 0) -> float:
    """Median over the surface of the angle between the normal and the mean normal of its neighbourhood on the same side.

    The median leaves out edges and folds that the object itself may have.
    """
    points, faces = sampled(mesh, SAMPLES, np.random.default_rng(seed))
    corners = mesh.vertices[mesh.faces[faces]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    a, b = cKDTree(points).query_pairs(ROUGHNESS_DIAMETERS * diameter_of(mesh), output_type="ndarray").T
    same_side = np.einsum("ij,ij->i", normals[a], normals[b]) > 0.0
    a, b = a[same_side], b[same_side]
    near = coo_matrix((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), (SAMPLES, SAMPLES)).tocsr()
    mean = near @ normals + normals
    enough = np.asarray(near.sum(1)).ravel() >= LEAST_NEIGHBOURS
    cosine = np.einsum("ij,ij->i", normals, mean) / np.maximum(np.linalg.norm(mean, axis=1), 1e-30)
    angles = np.degrees(np.arccos(np.clip(cosine[enough], -1.0, 1.0)))
    return float(np.median(angles)) if len(angles) else 0.0
