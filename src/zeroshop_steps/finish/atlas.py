"""The texture atlas as a grid of surface points: which face, and where on it, each texel shows."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from zeroshop_steps.geometry.meshes import Mesh


@dataclass(frozen=True)
class Texels:
    """The N texels whose centres lie in a chart.

    Attributes:
        row, column: (N,) position in the texture image, row 0 on top.
        face: (N,) index of the face shown.
        barycentric: (N, 3) float32 weights of its corners.
    """

    row: np.ndarray
    column: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray


def rasterize_atlas(mesh: Mesh, size: int) -> Texels:
    """Find the face and the barycentric position of every texel of a `size` x `size` texture."""
    corners = np.stack([mesh.uv[:, 0] * size, (1.0 - mesh.uv[:, 1]) * size], 1)
    face = _rasterize_faces(np.ascontiguousarray(corners), mesh.faces, size)
    row, column = np.nonzero(face >= 0)
    face = face[row, column].astype(np.int64)
    a, b, c = (corners[mesh.faces[face, corner]] for corner in range(3))
    point = np.stack([column + 0.5, row + 0.5], 1)
    area = _cross(b - a, c - a)
    area = np.where(np.abs(area) < 1e-12, 1e-12, area)
    second, third = _cross(point - a, c - a) / area, _cross(b - a, point - a) / area
    return Texels(row, column, face, np.stack([1.0 - second - third, second, third], 1).astype(np.float32))


def fill_gutters(texture: np.ndarray, texels: Texels) -> np.ndarray:
    """Give texels outside all charts the colour of the nearest chart texel, so that filtering never mixes in background."""
    empty = np.ones(texture.shape[:2], np.uint8)
    empty[texels.row, texels.column] = 0
    _, labels = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    source = np.zeros((int(labels.max()) + 1, texture.shape[2]), texture.dtype)
    source[labels[texels.row, texels.column]] = texture[texels.row, texels.column]
    return source[labels]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@njit(cache=True)
def _rasterize_faces(corners: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    owner = np.full((size, size), -1, np.int32)
    for f in range(len(faces)):
        ax, ay = corners[faces[f, 0]]
        bx, by = corners[faces[f, 1]]
        cx, cy = corners[faces[f, 2]]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-12:
            continue
        for y in range(max(0, int(np.floor(min(ay, by, cy) - 0.5))), min(size - 1, int(np.ceil(max(ay, by, cy)))) + 1):
            for x in range(max(0, int(np.floor(min(ax, bx, cx) - 0.5))), min(size - 1, int(np.ceil(max(ax, bx, cx)))) + 1):
                px, py = x + 0.5, y + 0.5
                second = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
                third = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
                if second >= -1e-9 and third >= -1e-9 and second + third <= 1.0 + 1e-9:
                    owner[y, x] = f
    return owner
