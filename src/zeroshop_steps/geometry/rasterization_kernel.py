"""Rasterization on the processor, compiled: what `rasterization.draw_in_parts` does, in a fraction of the time."""

import numba
import numpy as np


@numba.njit(cache=True, forceinline=True)
def _edge(x0, y0, x1, y1):
    """Twice the signed area of a triangle with the pixel, which is the origin."""
    return x0 * y1 - y0 * x1


@numba.njit(cache=True, parallel=True)
def draw_nearest(pixels, depths, faces, nearest_depth, face_of, shares_of):
    """Draw the faces of one mesh in P pictures, the nearest in front; of those at the same depth, the first.

    Args:
        pixels: (P, V, 2) float32, columns and rows of the vertices.
        depths: (P, V) float32.
        faces: (F, 3) int64.
        nearest_depth: faces with a corner no farther away are left out.
        face_of: (P, H, W) int64 to fill, -1 where nothing is.
        shares_of: (P, H, W, 3) float32 to fill, weights of the corners on the surface.
    """
    height, width = face_of.shape[1:]
    one, zero = np.float32(1), np.float32(0)
    for picture in numba.prange(len(pixels)):
        inverse = np.zeros((height, width), np.float32)  # of the depth so far
        for face in range(len(faces)):
            a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
            za, zb, zc = depths[picture, a], depths[picture, b], depths[picture, c]
            if min(za, zb, zc) <= nearest_depth:
                continue
            xa, ya = pixels[picture, a, 0], pixels[picture, a, 1]
            xb, yb = pixels[picture, b, 0], pixels[picture, b, 1]
            xc, yc = pixels[picture, c, 0], pixels[picture, c, 1]
            left, right = max(np.ceil(min(xa, xb, xc)), zero), min(np.floor(max(xa, xb, xc)), np.float32(width - 1))
            top, bottom = max(np.ceil(min(ya, yb, yc)), zero), min(np.floor(max(ya, yb, yc)), np.float32(height - 1))
            if left > right or top > bottom:
                continue
            for row in range(int(top), int(bottom) + 1):
                y = np.float32(row)
                for column in range(int(left), int(right) + 1):
                    x = np.float32(column)
                    ea = _edge(xb - x, yb - y, xc - x, yc - y)
                    eb = _edge(xc - x, yc - y, xa - x, ya - y)
                    ec = _edge(xa - x, ya - y, xb - x, yb - y)
                    if not ((ea >= zero and eb >= zero and ec >= zero) or (ea <= zero and eb <= zero and ec <= zero)):
                        continue
                    area = ea + eb + ec
                    if area == zero:
                        continue
                    wa, wb, wc = ea / area / za, eb / area / zb, ec / area / zc
                    near = wa + wb + wc
                    if near > inverse[row, column]:
                        inverse[row, column] = near
                        face_of[picture, row, column] = face
                        shares_of[picture, row, column, 0] = wa * (one / near)
                        shares_of[picture, row, column, 1] = wb * (one / near)
                        shares_of[picture, row, column, 2] = wc * (one / near)
