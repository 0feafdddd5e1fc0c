"""Faces that are no triangles, or that occur twice; and polygons, which become triangles: concave ones by manifold3d."""

import manifold3d
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

UPRIGHT_SHARE = 0.9  # by area: a polygon is cut where it hardly overlaps itself, seen along its normal
LEAST_TURNED = 1e-6  # share of a polygon's area in a triangle that faces the other way: less is what float32 leaves of a straight edge


def find_triangles(faces: np.ndarray) -> np.ndarray:
    """(F,) bool: faces with three different vertices."""
    return (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])


def label_parts(faces: np.ndarray) -> np.ndarray:
    """(F,) index of the connected part of each of (F, 3) faces, which are connected by common vertices."""
    a, b, c = faces.T
    size = int(faces.max(initial=-1)) + 1
    graph = coo_matrix((np.ones(2 * len(a), bool), (np.r_[a, b], np.r_[b, c])), (size, size))
    return np.unique(connected_components(graph, directed=False)[1][a], return_inverse=True)[1]


def drop_repeated_faces(faces: np.ndarray) -> np.ndarray:
    """The faces in their order, each set of three vertices once."""
    _, first = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    return faces[np.sort(first)]


def cut_polygons(places: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The (F,) polygons and (F, 3) corners of triangles: fans, where none folds. Polygons have so many of the (N, 3) places each."""
    triangles = np.maximum(counts - 2, 0)
    polygons = np.repeat(np.arange(len(counts)), triangles)
    second = np.arange(len(polygons)) - np.repeat(np.cumsum(triangles) - triangles, triangles) + 1
    corners = np.stack([np.zeros_like(second), second, second + 1], 1)
    starts = np.cumsum(counts) - counts
    one, other, third = places[starts[polygons] + corners.T]
    areas = np.cross(other - one, third - one)
    normals = np.stack([np.bincount(polygons, column, len(counts)) for column in areas.T], 1)[polygons]
    for polygon in np.unique(polygons[(areas * normals).sum(1) < -LEAST_TURNED * (normals**2).sum(1)]):
        if (cut := triangulate(places[starts[polygon] : starts[polygon] + counts[polygon]])) is not None:
            corners[polygons.searchsorted(polygon) :][: len(cut)] = cut
    return polygons, corners


def triangulate(points: np.ndarray) -> np.ndarray | None:
    """(N - 2, 3) corners of triangles over a closed (N, 3) chain, facing where it runs counter-clockwise; None of one far from flat."""
    around = points - points.mean(0)
    normal = np.cross(around, np.roll(around, -1, 0)).sum(0)
    if not (length := np.linalg.norm(normal)):
        return None
    flat = around @ make_plane_axes(normal / length).T
    index = manifold3d.triangulate([flat], allow_convex=False)
    (ax, ay), (bx, by), (cx, cy) = flat[index].transpose(1, 2, 0)
    areas = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    return None if areas.sum() < UPRIGHT_SHARE * np.abs(areas).sum() or len(index) != len(points) - 2 else index


def make_plane_axes(normal: np.ndarray) -> np.ndarray:
    """(2, 3) unit axes of the plane with this (3,) unit normal; with the normal as the third, they are right-handed."""
    across = np.linalg.svd(normal[None])[2][1:]
    return across[::-1] if np.linalg.det(np.stack([*across, normal])) < 0 else across
