"""Rasterization, compiled for the processor.

cuda_rasterization.py shares the functions for one face.
"""

import math

import numba
import numpy as np

BANDS_PER_THREAD = 2
"""An object is seldom spread evenly over the rows of a picture."""


def draw_faces(
    pixels: np.ndarray, depths: np.ndarray, faces: np.ndarray, nearest_depth: float, shape: tuple[int, int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """What `draw_nearest` fills, for pictures of this shape (P, H, W): inverse depth and face."""
    inverse_depth, face_of = np.empty(shape, np.float32), np.empty(shape, np.int32)
    bands = min(-(-BANDS_PER_THREAD * numba.get_num_threads() // len(pixels)), shape[1])
    draw_nearest(pixels, depths, faces, nearest_depth, bands, inverse_depth, face_of)
    return inverse_depth, face_of


@numba.njit(cache=True, forceinline=True)
def _edge(px, py, qx, qy, x, y):
    """Twice the signed area of a triangle with a pixel; with p and q exchanged, the same number with the other sign, on any device."""
    if px < qx or (px == qx and py < qy):
        return (px - x) * (qy - y) - (py - y) * (qx - x)
    return -((qx - x) * (py - y) - (qy - y) * (px - x))


@numba.njit(cache=True, forceinline=True)
def weigh_corners(corners, x, y):
    """The shares of a face's corners at a pixel, each over the depth there, so that their sum is the inverse depth; 0 outside the face.

    Args:
        corners: column, row and depth of the first corner, then of the others, float32.
        x, y: float32, the pixel's column and row.
    """
    xa, ya, za, xb, yb, zb, xc, yc, zc = corners
    zero = np.float32(0)
    ea, eb, ec = _edge(xb, yb, xc, yc, x, y), _edge(xc, yc, xa, ya, x, y), _edge(xa, ya, xb, yb, x, y)
    area = ea + eb + ec
    if area == zero or not ((ea >= zero and eb >= zero and ec >= zero) or (ea <= zero and eb <= zero and ec <= zero)):
        return zero, zero, zero
    return ea / area / za, eb / area / zb, ec / area / zc


@numba.njit(cache=True, forceinline=True)
def read_corners(pixels, depths, faces, face):
    """Column, row and depth of the three corners of a face, for `weigh_corners`."""
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    return pixels[a, 0], pixels[a, 1], depths[a], pixels[b, 0], pixels[b, 1], depths[b], pixels[c, 0], pixels[c, 1], depths[c]


@numba.njit(cache=True, forceinline=True)
def find_pixels(corners, first_row, last_row, width, nearest_depth):
    """The first and last column and row that a face may cover, of these rows: none where a corner is no farther than the nearest."""
    xa, ya, za, xb, yb, zb, xc, yc, zc = corners
    if min(za, zb, zc) <= nearest_depth:
        return 0, -1, 0, -1
    left, right = max(math.ceil(min(xa, xb, xc)), 0), min(math.floor(max(xa, xb, xc)), width - 1)
    top, bottom = max(math.ceil(min(ya, yb, yc)), first_row), min(math.floor(max(ya, yb, yc)), last_row)
    return left, right, top, bottom


@numba.njit(cache=True, forceinline=True)
def share_pixel(corners, picture, row, column, shares):
    """Write the shares of a face's corners at a pixel into (P, H, W, 3) float32, unless the pixel lies outside the face."""
    wa, wb, wc = weigh_corners(corners, np.float32(column), np.float32(row))
    near = wa + wb + wc
    if near > np.float32(0):  # a device that found the face may round otherwise at its rim
        depth = np.float32(1) / near
        shares[picture, row, column, 0] = wa * depth
        shares[picture, row, column, 1] = wb * depth
        shares[picture, row, column, 2] = wc * depth


@numba.njit(cache=True, parallel=True)
def draw_nearest(pixels, depths, faces, nearest_depth, bands, inverse_depth, face_of):
    """Draw the faces of one mesh in P pictures, the nearest in front; of those at the same depth, the first.

    Args:
        pixels: (P, V, 2) float32, columns and rows of the vertices.
        depths: (P, V) float32.
        faces: (F, 3) integers.
        nearest_depth: faces with a corner no farther away are left out.
        bands: of rows, each of which a thread draws.
        inverse_depth: (P, H, W) float32 to fill, 0 where nothing is.
        face_of: (P, H, W) int32 to fill, -1 where nothing is.
    """
    height, width = face_of.shape[1:]
    # So that each band reads the corners of its own faces alone; where a band is a picture, it reads all of them anyway.
    rows_of = np.empty((len(pixels) if bands > 1 else 0, len(faces), 2), np.int32)
    for part in numba.prange(len(rows_of) * bands):
        picture, chunk = part // bands, part % bands
        for face in range(chunk * len(faces) // bands, (chunk + 1) * len(faces) // bands):
            corners = read_corners(pixels[picture], depths[picture], faces, face)
            _, _, rows_of[picture, face, 0], rows_of[picture, face, 1] = find_pixels(corners, 0, height - 1, width, nearest_depth)
    for part in numba.prange(len(pixels) * bands):
        picture, band = part // bands, part % bands
        first, last = band * height // bands, (band + 1) * height // bands - 1
        inverse, found = inverse_depth[picture], face_of[picture]
        inverse[first : last + 1], found[first : last + 1] = 0, -1
        for face in range(len(faces)):
            if bands > 1 and (rows_of[picture, face, 0] > last or rows_of[picture, face, 1] < first):
                continue
            corners = read_corners(pixels[picture], depths[picture], faces, face)
            left, right, top, bottom = find_pixels(corners, first, last, width, nearest_depth)
            for row in range(top, bottom + 1):
                for column in range(left, right + 1):
                    wa, wb, wc = weigh_corners(corners, np.float32(column), np.float32(row))
                    near = wa + wb + wc
                    if near > inverse[row, column]:
                        inverse[row, column], found[row, column] = near, face


@numba.njit(cache=True, parallel=True)
def find_shares(pixels, depths, faces, face_of, shares_of):
    """Fill (P, H, W, 3) float32 shares of the corners on the surface, by the faces that `draw_nearest` found; 0 where nothing is."""
    pictures, height, width = face_of.shape
    for line in numba.prange(pictures * height):
        picture, row = line // height, line % height
        for column in range(width):
            shares_of[picture, row, column] = 0
            face = face_of[picture, row, column]
            if face >= 0:
                corners = read_corners(pixels[picture], depths[picture], faces, face)
                share_pixel(corners, picture, row, column, shares_of)
