"""Transfer what one view shows into another: by a plane, along the visual hull, or between matches.

A plane through a point (a local homography) needs cameras, the front of the visual hull needs masks, too, and matches need neither.
`score` says how well both then agree.
"""

from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial import Delaunay

from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.register.photometry.hull_views import SmallView

VISIBLE = 0.06  # of the radius: how near to the hull's front in the neighbour a point lies that it sees

Carry = Callable[[np.ndarray, float], tuple[np.ndarray, np.ndarray]]


def span_axes(normals: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(P, 2, 3) unit vectors in the planes of (P, 3) unit normals: nearest to a (3,) `right`, and the other, down, square to that."""
    along = right - normals * (normals @ right)[:, None]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([along, np.cross(normals, -along)], axis=1)


def cut_patch(image: np.ndarray, axes: np.ndarray, middle: np.ndarray, half_px: int) -> np.ndarray:
    """The (2 half + 1) squared patch around a pixel of an image; the (2, 2) `axes` map steps of the patch to steps of the image."""
    corner = middle - 0.5 - axes.sum(1) * half_px  # OpenCV's pixels have their centres at integers
    side = 2 * half_px + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, np.column_stack([axes, corner]), (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE)


def carry_by_plane(point: np.ndarray, plane: np.ndarray, grey: np.ndarray, camera: Camera, other: Camera, half_px: int) -> np.ndarray:
    """What an image shows around a point, as another camera would see it, if the surface is a plane there.

    Args:
        point, plane: (3,) each, the second normal to the plane.
        grey, camera: (H, W) picture and its camera.
        other: the other camera.
        half_px: of the patch, which has the other camera's pixels.
    """
    corners = other.project(point[None])[0][0] + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = np.c_[corners, np.ones(3)] @ np.linalg.inv(other.intrinsics).T @ other.camera_from_world[:3, :3]
    # Where the rays through the point's pixel and its neighbours meet the plane.
    reached = other.centre_in_world + rays * (((point - other.centre_in_world) @ plane) / (rays @ plane))[:, None]
    centre, *ends = camera.project(reached)[0]
    return cut_patch(grey, np.stack([end - centre for end in ends], axis=1), centre, half_px)


def carry_along_hull(one: SmallView, other: SmallView) -> Carry:
    """What carries what another view shows into this one, along the hull's front or behind it."""
    rows, columns = np.nonzero(one.depth > 0)
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], 1) @ np.linalg.inv(one.camera.intrinsics).T
    world_from_camera = np.linalg.inv(one.camera.camera_from_world)

    def carry(values: np.ndarray, behind: float) -> tuple[np.ndarray, np.ndarray]:
        """(H, W) what another view holds at the places of this one's pixels, and the (P,) depths there."""
        points = (rays * (one.depth[rows, columns] + behind)[:, None]) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        pixels, depth = other.camera.project(points)
        places = np.full((*one.depth.shape, 2), -1e3, np.float32)
        places[rows, columns] = pixels - 0.5
        return cv2.remap(values, places[..., 0], places[..., 1], cv2.INTER_LINEAR), depth

    return carry


def carry_in_place(one: SmallView, other: SmallView, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) what another view shows, carried into this one along the hull's front, and bool where both see the hull."""
    carry = carry_along_hull(one, other)
    carried, depth = carry(other.grey, 0.0)
    front, _ = carry(other.depth.astype(np.float32), 0.0)
    seen = one.depth > 0
    seen[seen] = np.abs(front[seen] - depth) < VISIBLE * radius
    return carried, seen


def find_between_matches(triangles: Delaunay, other_points: np.ndarray, width_px: int, height_px: int, longest_px: float) -> np.ndarray:
    """(H, W, 2) float32 where each pixel lies in the other picture, as OpenCV counts, linearly in each triangle between matches.

    Args:
        triangles: of (M, 2) points in this picture.
        other_points: (M, 2) where they lie in the other picture.
        width_px, height_px: of this picture.
        longest_px: edge of a triangle: in larger ones the surface is not flat, and what lies there is put far outside.
    """
    y, x = np.mgrid[:height_px, :width_px]
    pixels = np.stack([x.ravel(), y.ravel()], 1) + 0.5
    at = triangles.find_simplex(pixels)
    corners = triangles.points[triangles.simplices]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    held = np.flatnonzero((at >= 0) & (longest[at] < longest_px))
    transform = triangles.transform[at[held]]
    first = np.einsum("pij,pj->pi", transform[:, :2], pixels[held] - transform[:, 2])
    weights = np.concatenate([first, 1 - first.sum(1, keepdims=True)], axis=1)
    places = np.full((height_px * width_px, 2), -1e3, np.float32)
    places[held] = (other_points[triangles.simplices[at[held]]] * weights[..., None]).sum(1) - 0.5
    return places.reshape(height_px, width_px, 2)
