"""What a mesh says about its quality by its shape: whether it is in one part, closed, smooth, and where the evidence puts it."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

from zeroshop_steps.finish.closing.underside import NEAR_DIAGONALS
from zeroshop_steps.geometry.alignment.robust_estimates import AGREEING_VIEWS
from zeroshop_steps.geometry.alignment.surface_distance import SHARE_SAMPLES, count_seeing_views, sample_surface
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.meshes.mesh_repair import label_parts
from zeroshop_steps.geometry.meshes.surface_fields import weld
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh, diameter_of, number_edges
from zeroshop_steps.geometry.observation.support_classes import ASSUMED, MEASURED
from zeroshop_steps.geometry.observation.visual_hull import measure_hull_depth

ROUGHNESS_DIAMETERS = 0.02  # radius of the neighbourhood within which normals are compared; 4 mm on an object of 20 cm
GUESSED_DIAMETERS = 0.03  # deeper below the outlines; between two cameras, the hull of a right surface bulges by 0.02
LEAST_NEIGHBOURS = 4  # points with fewer do not count: a mean of so few normals is mostly chance
INWARDS = 0.1  # share of the way from a border to the middle of its face at which rays are aimed; at the border itself they may miss it


def measure_largest_part_share(mesh: Mesh) -> float:
    """Area of the largest connected part as a share of the whole; vertices at the same position are joined."""
    joined, _ = weld(mesh)
    areas = np.bincount(label_parts(joined.faces), joined.face_areas())
    return float(areas.max() / max(areas.sum(), 1e-30))


def measure_open_boundary(mesh: Mesh, cameras: Sequence[Camera], support_z: float | None) -> float:
    """Length of the edges that belong to one face only, in diameters, as far as at least two cameras see that face.

    The border of a side that no photo shows is no fault, nor is the rim of the unseen underside, although cameras see it.

    Args:
        mesh: object frame, z up.
        cameras: of the photos, in the object frame.
        support_z: height of the support; borders close to it do not count. None if photos show the underside.
    """
    joined, _ = weld(mesh)
    edges = np.sort(joined.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, first, count = np.unique(number_edges(edges), return_index=True, return_counts=True)
    ends, faces = joined.vertices[edges[first[count == 1]]], first[count == 1] // 3
    diameter = diameter_of(joined)
    points = (1 - INWARDS) * ends.mean(1) + INWARDS * joined.vertices[joined.faces[faces]].mean(1)
    counts = count_seeing_views(points, joined.face_normals()[faces], joined, list(cameras), support_z) >= AGREEING_VIEWS
    if support_z is not None:
        counts &= points[:, 2] > support_z + NEAR_DIAGONALS * diameter
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)[counts].sum() / diameter)


def measure_guessed_share(mesh: Mesh, views: Sequence[View], inferred: slice = slice(0)) -> float:
    """Share of the surface that nothing holds where it is: neither stereo nor an outline measured it, and the masks leave room.

    Where only masks limit a surface, it should lie on their visual hull. If it lies deeper, such as the floor of a dark hollow or a dent
    in a plain wall, it may as well lie elsewhere. The inside of a hollow is no guess if it was opened because the photos agree on its
    colours (finish/closing/hollows.py).

    Args:
        mesh: with the classes of its surface support (geometry/observation/support_classes.py) as its quality.
        views: the photos with masks, their cameras in the frame of the mesh.
        inferred: the faces of such a hollow.
    """
    room = measure_hull_depth(mesh.vertices, [view.camera for view in views], [view.mask() for view in views])
    assumed = np.isclose(mesh.require_quality() * MEASURED, ASSUMED)
    guessed = (assumed & (room > GUESSED_DIAMETERS * diameter_of(mesh)))[mesh.faces].mean(1)
    guessed[inferred] = 0.0
    return float(mesh.face_areas() @ guessed / max(mesh.face_areas().sum(), 1e-30))


def measure_roughness_deg(mesh: Mesh) -> float:
    """Median over the surface of the angle between the normal and the mean normal of its neighbourhood on the same side.

    Edges and folds of the object itself are few, so they hardly change the median.
    """
    points, faces, _ = sample_surface(mesh, SHARE_SAMPLES, np.random.default_rng(0))
    normals = mesh.face_normals()[faces]
    a, b = cKDTree(points).query_pairs(ROUGHNESS_DIAMETERS * diameter_of(mesh), output_type="ndarray").T
    same_side = np.einsum("ij,ij->i", normals[a], normals[b]) > 0.0
    a, b = a[same_side], b[same_side]
    near = coo_matrix((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), (SHARE_SAMPLES, SHARE_SAMPLES)).tocsr()
    mean = near @ normals + normals
    enough = np.asarray(near.sum(1)).ravel() >= LEAST_NEIGHBOURS
    cosine = np.einsum("ij,ij->i", normals, mean) / np.maximum(np.linalg.norm(mean, axis=1), 1e-30)
    angles = np.degrees(np.arccos(np.clip(cosine[enough], -1.0, 1.0)))
    return float(np.median(angles)) if len(angles) else 0.0
