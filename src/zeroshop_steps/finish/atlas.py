"""Which point of the surface each texel of the texture atlas shows."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from zeroshop_steps.geometry.images import spread_colors
from zeroshop_steps.geometry.meshes import Mesh

FLAT_TEXELS2 = 1e-12  # twice the area below which a face is a line in the atlas and has no barycentric coordinates
BORDER_SLACK = 1e-9  # rounding by which a texel's centre on a shared edge may miss both faces


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
    uv = mesh.texture_coordinates
    corners = np.stack([uv[:, 0] * size, (1.0 - uv[:, 1]) * size], 1)
    face = _rasterize_faces(np.ascontiguousarray(corners), mesh.faces, size)
    row, column = np.nonzero(face >= 0)
    face = face[row, column].astype(np.int64)
    a, b, c = (corners[mesh.faces[face, corner]] for corner in range(3))
    point = np.stack([column + 0.5, row + 0.5], 1)
    area = _cross(b - a, c - a)
    area = np.where(np.abs(area) < FLAT_TEXELS2, FLAT_TEXELS2, area)
    second, third = _cross(point - a, c - a) / area, _cross(b - a, point - a) / area
    return Texels(row, column, face, np.stack([1.0 - second - third, second, third], 1).astype(np.float32))


def fill_gutters(texture: np.ndarray, texels: Texels) -> np.ndarray:
    """Give texels outside all charts the colour of the nearest chart texel, so that filtering never mixes in background."""
    known = np.zeros(texture.shape[:2], bool)
    known[texels.row, texels.column] = True
    return spread_colors(texture, known)


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
        if abs(area) < FLAT_TEXELS2:
            continue
        for y in range(max(0, int(np.floor(min(ay, by, cy) - 0.5))), min(size - 1, int(np.ceil(max(ay, by, cy)))) + 1):
            for x in range(max(0, int(np.floor(min(ax, bx, cx) - 0.5))), min(size - 1, int(np.ceil(max(ax, bx, cx)))) + 1):
                px, py = x + 0.5, y + 0.5
                second = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
                third = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
                if second >= -BORDER_SLACK and third >= -BORDER_SLACK and second + third <= 1.0 + BORDER_SLACK:
                    owner[y, x] = f
    return owner
