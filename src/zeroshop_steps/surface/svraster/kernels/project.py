"""From voxels to rows of numbers that a pixel's ray needs, and back: one row a voxel and view.

With d the world direction of a pixel's ray (of unit depth along the optical axis) and z_c the depth of the voxel's centre
c, the ray is (o + z_c d) + s tau d. In the voxel's own frame, centred and of unit edge, its point is e + tau d with

    e = (o + z_c d - c) / s = A (x - x_0) + B (y - y_0) + C,

affine in the pixel around a reference pixel near the voxel, so that nothing cancels in single precision. The voxel's
density is the trilinear polynomial of its eight corners' values in these coordinates.
"""

import math

import numba
import numpy as np

from zeroshop_steps.surface.rendering.spherical_harmonics import sh_basis, view_direction
from zeroshop_steps.surface.svraster.kernels import layout as at

# Divisions may become products with a reciprocal, and sums fused: all is in double precision.
_REORDERED = {"arcp", "contract", "nsz"}
FLAT = 1e-12
"""Squared length of the density's gradient, per voxel, that leaves the normal undetermined."""


@numba.njit(cache=True, forceinline=True)
def _polynomial(v, p):
    """Fill p (8,) with the coefficients of the trilinear interpolation of corner values v (8,), centred coordinates in [-1/2, 1/2]."""
    p[0] = (v[0] + v[1] + v[2] + v[3] + v[4] + v[5] + v[6] + v[7]) / 8.0
    p[1] = (-v[0] + v[1] - v[2] + v[3] - v[4] + v[5] - v[6] + v[7]) / 4.0
    p[2] = (-v[0] - v[1] + v[2] + v[3] - v[4] - v[5] + v[6] + v[7]) / 4.0
    p[3] = (-v[0] - v[1] - v[2] - v[3] + v[4] + v[5] + v[6] + v[7]) / 4.0
    p[4] = (v[0] - v[1] - v[2] + v[3] + v[4] - v[5] - v[6] + v[7]) / 2.0
    p[5] = (v[0] - v[1] + v[2] - v[3] - v[4] + v[5] - v[6] + v[7]) / 2.0
    p[6] = (v[0] + v[1] - v[2] - v[3] - v[4] - v[5] + v[6] + v[7]) / 2.0
    p[7] = -v[0] + v[1] + v[2] - v[3] + v[4] - v[5] - v[6] + v[7]


@numba.njit(cache=True, forceinline=True)
def _polynomial_backward(g, out):
    """The transpose of `_polynomial`: gradients by coefficients g (8,) to gradients by corner values, into out (8,)."""
    for c in range(8):
        x, y, z = 2.0 * (c & 1) - 1.0, 2.0 * (c >> 1 & 1) - 1.0, 2.0 * (c >> 2 & 1) - 1.0
        first = g[0] / 8.0 + (x * g[1] + y * g[2] + z * g[3]) / 4.0
        out[c] = first + (x * y * g[4] + x * z * g[5] + y * z * g[6]) / 2.0 + x * y * z * g[7]


# Inlined by Numba, not by LLVM: within the loop, the compiler knows that the arrays do not overlap.
@numba.njit(inline="always", error_model="numpy", fastmath=_REORDERED)
def project_voxel(
    centres, sizes, corners, densities, sh, i, degree, camera, width_px, height_px, near, c, v, p, basis, rows, boxes
):  # fmt: skip
    """Voxel i of `project_forward`; c (3,), v (8,), p (8,) and basis (16,) float64 are overwritten."""
    fx, fy, cx, cy = camera[12], camera[13], camera[14], camera[15]
    for r in range(3):
        total = camera[3 * r] * centres[i, 0] + camera[3 * r + 1] * centres[i, 1] + camera[3 * r + 2] * centres[i, 2]
        c[r] = camera[9 + r] + total
    s = sizes[i]
    if not _box(c, s, camera, width_px, height_px, near, boxes, i):
        boxes[i, 0] = boxes[i, 1] = boxes[i, 2] = boxes[i, 3] = 0
        return
    x0, y0 = cx, cy
    if c[2] > near:
        x0 = min(max(math.floor(fx * c[0] / c[2] + cx), 0.0), float(width_px))
        y0 = min(max(math.floor(fy * c[1] / c[2] + cy), 0.0), float(height_px))
    rows[i, at.X0], rows[i, at.Y0], rows[i, at.ZC], rows[i, at.SIZE], rows[i, at.TAU_MIN] = (
        x0,
        y0,
        c[2],
        s,
        (near - c[2]) / s,
    )
    # The point of the reference ray at the centre's depth, less the centre, in the camera frame.
    ox, oy = (x0 - cx) / fx * c[2] - c[0], (y0 - cy) / fy * c[2] - c[1]
    for a in range(3):
        rows[i, at.A0 + a] = c[2] / (fx * s) * camera[a]
        rows[i, at.B0 + a] = c[2] / (fy * s) * camera[3 + a]
        rows[i, at.C0 + a] = (ox * camera[a] + oy * camera[3 + a]) / s
    for k in range(8):
        v[k] = densities[corners[i, k]]
    _polynomial(v, p)
    for k in range(8):
        rows[i, at.P1 + k] = p[k]
    inverse = -1.0 / math.sqrt(p[1] * p[1] + p[2] * p[2] + p[3] * p[3] + FLAT)
    for r in range(3):
        rows[i, at.NX + r] = inverse * (camera[3 * r] * p[1] + camera[3 * r + 1] * p[2] + camera[3 * r + 2] * p[3])
    dx, dy, dz, _ = view_direction(centres, i, camera)
    sh_basis(degree, dx, dy, dz, basis)
    red = green = blue = 0.5
    for k in range((degree + 1) * (degree + 1)):
        red += basis[k] * sh[i, k, 0]
        green += basis[k] * sh[i, k, 1]
        blue += basis[k] * sh[i, k, 2]
    rows[i, at.RED], rows[i, at.GREEN], rows[i, at.BLUE] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)


@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath=_REORDERED)
def project_forward(centres, sizes, corners, densities, sh, degree, camera, width_px, height_px, near, workers, rows, boxes):
    """Fill the row and the pixel box of every voxel.

    Args:
        centres (N, 3), sizes (N,): float64, normalized coordinates.
        corners (N, 8) int32 into densities (M,) float32, the values before activation.
        sh (N, K, 3) float32 spherical-harmonics coefficients, K at least (degree + 1)^2.
        camera (16,) float64: camera_from_world's rotation (9), translation (3), then fx, fy, cx, cy.
        near: depth before which nothing is drawn.
        workers: number of threads.
        rows (N, 28) float32: filled where drawn. boxes (N, 4) int32: filled with x0, x1, y0, y1, half open; empty where not drawn.
    """
    for worker in numba.prange(workers):
        c, v, p, basis = np.empty(3), np.empty(8), np.empty(8), np.empty(16)
        for i in range(worker * len(centres) // workers, (worker + 1) * len(centres) // workers):
            project_voxel(centres, sizes, corners, densities, sh, i, degree, camera, width_px, height_px, near, c, v, p, basis, rows, boxes)


@numba.njit(cache=True, forceinline=True, error_model="numpy", fastmath=_REORDERED)
def _box(c, s, camera, width_px, height_px, near, boxes, i):
    """Fill row i of boxes (N, 4) around the eight corners of a voxel with centre c in the camera frame; False when out of sight."""
    reach = 0.5 * s * (abs(camera[6]) + abs(camera[7]) + abs(camera[8]))
    if c[2] + reach <= near:
        return False
    if c[2] - reach <= 0.5 * near:
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = 0, width_px, 0, height_px
        return True
    left, right, top, bottom = 1e30, -1e30, 1e30, -1e30
    for k in range(8):
        x, y, z = s * ((k & 1) - 0.5), s * ((k >> 1 & 1) - 0.5), s * ((k >> 2 & 1) - 0.5)
        inverse = 1.0 / (c[2] + camera[6] * x + camera[7] * y + camera[8] * z)
        u = (c[0] + camera[0] * x + camera[1] * y + camera[2] * z) * inverse
        w = (c[1] + camera[3] * x + camera[4] * y + camera[5] * z) * inverse
        left, right, top, bottom = min(left, u), max(right, u), min(top, w), max(bottom, w)
    left, right = camera[12] * left + camera[14], camera[12] * right + camera[14]
    top, bottom = camera[13] * top + camera[15], camera[13] * bottom + camera[15]
    # Pixel j's centre is at j + 0.5; a hundredth of a pixel more, against rounding.
    boxes[i, 0] = int(min(max(math.ceil(left - 0.51), 0.0), width_px))
    boxes[i, 1] = int(min(max(math.floor(right + 0.51), 0.0), width_px))
    boxes[i, 2] = int(min(max(math.ceil(top - 0.51), 0.0), height_px))
    boxes[i, 3] = int(min(max(math.floor(bottom + 0.51), 0.0), height_px))
    return boxes[i, 0] < boxes[i, 1] and boxes[i, 2] < boxes[i, 3]


@numba.njit(inline="always", error_model="numpy", fastmath=_REORDERED)
def differentiate_voxel(centres, i, degree, camera, rows, gradients, g, out, basis, corner_gradients, sh_gradients):
    """Voxel i of `project_backward`; g (8,), out (8,) and basis (16,) float64 are overwritten."""
    for k in range(8):
        g[k] = gradients[i, at.G_P + k]
    p1, p2, p3 = float(rows[i, at.PX]), float(rows[i, at.PY]), float(rows[i, at.PZ])
    inverse = -1.0 / math.sqrt(p1 * p1 + p2 * p2 + p3 * p3 + FLAT)
    n0, n1, n2 = gradients[i, at.G_NX], gradients[i, at.G_NX + 1], gradients[i, at.G_NX + 2]
    g0 = camera[0] * n0 + camera[3] * n1 + camera[6] * n2
    g1 = camera[1] * n0 + camera[4] * n1 + camera[7] * n2
    g2 = camera[2] * n0 + camera[5] * n1 + camera[8] * n2
    along = (g0 * p1 + g1 * p2 + g2 * p3) * inverse * inverse
    g[1] += inverse * (g0 - along * p1)
    g[2] += inverse * (g1 - along * p2)
    g[3] += inverse * (g2 - along * p3)
    _polynomial_backward(g, out)
    for k in range(8):
        corner_gradients[i, k] = out[k]
    dx, dy, dz, _ = view_direction(centres, i, camera)
    sh_basis(degree, dx, dy, dz, basis)
    red = gradients[i, at.G_RED] if rows[i, at.RED] > 0.0 else 0.0
    green = gradients[i, at.G_RED + 1] if rows[i, at.GREEN] > 0.0 else 0.0
    blue = gradients[i, at.G_RED + 2] if rows[i, at.BLUE] > 0.0 else 0.0
    for k in range((degree + 1) * (degree + 1)):
        sh_gradients[i, k, 0], sh_gradients[i, k, 1], sh_gradients[i, k, 2] = red * basis[k], green * basis[k], blue * basis[k]


@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath=_REORDERED)
def project_backward(centres, degree, camera, workers, rows, seen, gradients, corner_gradients, sh_gradients):
    """Carry the gradients (N, 16) of the rows back to corner values (N, 8) and sh (N, K, 3), which must both hold zeros.

    seen: (N,) bool, the voxels that have a gradient.
    """
    for worker in numba.prange(workers):
        g, out, basis = np.empty(8), np.empty(8), np.empty(16)
        for i in range(worker * len(centres) // workers, (worker + 1) * len(centres) // workers):
            if seen[i]:
                differentiate_voxel(centres, i, degree, camera, rows, gradients, g, out, basis, corner_gradients, sh_gradients)


@numba.njit(inline="always")
def sum_uses(starts, uses, corner_gradients, corner):
    """One corner of `gather_corners`."""
    total = np.float32(0.0)
    for position in range(starts[corner], starts[corner + 1]):
        total += corner_gradients[uses[position]]
    return total


@numba.njit(cache=True, parallel=True)
def gather_corners(starts, uses, corner_gradients, out):
    """Sum (8 N,) gradients by voxel corner into out (M,) by shared corner, in fixed order."""
    for corner in numba.prange(len(out)):
        out[corner] = sum_uses(starts, uses, corner_gradients, corner)
