"""Which point of the surface each texel of the texture atlas shows."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from zeroshop_steps.geometry.imaging.images import spread_colors
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh

FLAT_TEXELS2 = 1e-12  # twice the area below which a face is a line in the atlas and has no barycentric coordinates
BORDER_SLACK = 1e-9  # rounding by which a texel's centre on a shared edge may miss both faces


@dataclass(frozen=True)
class Texels:
    """The N texels whose centres lie in a chart.

    Attributes:
        row, column: (N,) position in the texture image, row 0 on top.
        face: (N,) int32 index of the face shown.
        barycentric: (N, 3) float32 weights of its corners.
    """

    row: np.ndarray
    column: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray


def rasterize_atlas(mesh: Mesh, size: int) -> Texels:
    """Find the face and the barycentric position of every texel of a `size` x `size` texture."""
    uv = mesh.texture_coordinates
    corners = np.ascontiguousarray(np.stack([uv[:, 0] * size, (1.0 - uv[:, 1]) * size], 1))
    owner = _rasterize_faces(corners, mesh.faces, size)
    row, column = np.nonzero(owner >= 0)
    face = owner[row, column]
    return Texels(row, column, face, _find_shares(corners, mesh.faces, row, column, face))


def fill_gutters(texture: np.ndarray, texels: Texels) -> np.ndarray:
    """Give texels outside all charts the colour of the nearest chart texel, so that filtering never mixes in background."""
    known = np.zeros(texture.shape[:2], bool)
    known[texels.row, texels.column] = True
    return spread_colors(texture, known)


@njit(cache=True, forceinline=True)
def _locate(a: np.ndarray, b: np.ndarray, c: np.ndarray, x: float, y: float) -> tuple[float, float, float]:
    """Twice the signed area of a triangle, and the weights of its second and third corner at (x, y), times that area."""
    second = (x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])
    third = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]), second, third


@njit(cache=True)
def _rasterize_faces(corners: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """(size, size) int32 face whose triangle holds a texel's centre, the last of several; -1 where none does."""
    owner = np.full((size, size), -1, np.int32)
    for f in range(len(faces)):
        a, b, c = corners[faces[f, 0]], corners[faces[f, 1]], corners[faces[f, 2]]
        if abs(_locate(a, b, c, 0.0, 0.0)[0]) < FLAT_TEXELS2:
            continue
        top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        for y in range(max(0, int(np.floor(top - 0.5))), min(size - 1, int(np.ceil(bottom))) + 1):
            for x in range(max(0, int(np.floor(left - 0.5))), min(size - 1, int(np.ceil(right))) + 1):
                area, second, third = _locate(a, b, c, x + 0.5, y + 0.5)
                second, third = second / area, third / area
                if second >= -BORDER_SLACK and third >= -BORDER_SLACK and second + third <= 1.0 + BORDER_SLACK:
                    owner[y, x] = f
    return owner


@njit(cache=True)
def _find_shares(corners: np.ndarray, faces: np.ndarray, row: np.ndarray, column: np.ndarray, face: np.ndarray) -> np.ndarray:
    """(N, 3) float32 barycentric weights of the corners of (N,) faces at the centres of texels."""
    shares = np.empty((len(face), 3), np.float32)
    for i in range(len(face)):
        a, b, c = faces[face[i]]
        area, second, third = _locate(corners[a], corners[b], corners[c], column[i] + 0.5, row[i] + 0.5)
        shares[i, 0], shares[i, 1], shares[i, 2] = 1.0 - second / area - third / area, second / area, third / area
    return shares
