"""From surfels in the world to splats on the image: the projection of 2D Gaussian Splatting, forward and backward.

A surfel is a planar Gaussian disk with centre p, unit tangents t_u, t_v and scales s_u, s_v (Huang et al. 2024, eq. 4).
The pixel ray through (x, y) meets its plane at local coordinates (u, v), a projective map of the pixel (eq. 8 to 10).
Written around the projected centre c = (c_x, c_y), with dx = x - c_x and dy = y - c_y, that map has no constant term:

    a = 1 + a_1 dx + a_2 dy,   u = (u_1 dx + u_2 dy) / a,   v = (v_1 dx + v_2 dy) / a,   z = z_c / a

so nine numbers describe the surfel exactly, and no precision is lost by cancellation far from the image's origin.
Appearance is a real spherical-harmonics expansion up to degree 3 in the viewing direction (Kerbl et al. 2023).
"""

import math

import numba
import numpy as np

from zeroshop_steps.surface.rendering.spherical_harmonics import sh_basis, sh_gradient, view_direction
from zeroshop_steps.surface.twodgs.kernels import layout as at

ALPHA_MIN = 1.0 / 255.0
"""Contributions below one grey level are skipped, and end a splat's footprint."""
MARGIN_PX = 0.02
"""Footprints are enlarged by this, against rounding."""
GRAZING_MIN = 1e-7
"""Sine of the angle between ray and surfel below which only the low-pass filter draws the surfel."""


# Divisions may become products with a reciprocal, and sums fused: all is in double precision. Infinity keeps its meaning.
_REORDERED = {"arcp", "contract", "nsz"}


@numba.njit(cache=True, forceinline=True, fastmath=_REORDERED)
def rotation_of(w, x, y, z, rotation):
    """Fill rotation (3, 3) from a quaternion of any length; returns one over the length."""
    inverse = 1.0 / max(math.sqrt(w * w + x * x + y * y + z * z), 1e-12)
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return inverse


@numba.njit(cache=True, forceinline=True, fastmath=_REORDERED)
def _outline(zc, fx, fy, kx, ky, su, sv, camera_tangents, radius_squared, outlines, i):
    """Fill row i of outlines (N, 6).

    camera_tangents (3, 3): rows are the tangents and the normal in the camera frame; kx, ky: principal point relative to the centre.
    The ellipse is the projection of u^2 + v^2 = radius_squared (Weyrich et al. 2007, as used in 2DGS, sec. 4.2).
    """
    t = camera_tangents
    tu0, tu1 = su * (fx * t[0, 0] + kx * t[0, 2]), sv * (fx * t[1, 0] + kx * t[1, 2])
    tv0, tv1 = su * (fy * t[0, 1] + ky * t[0, 2]), sv * (fy * t[1, 1] + ky * t[1, 2])
    tw0, tw1 = su * t[0, 2], sv * t[1, 2]
    outlines[i, at.LOW_PASS] = math.sqrt(0.5 * radius_squared)
    outlines[i, at.HALF_X] = np.inf
    d = radius_squared * (tw0 * tw0 + tw1 * tw1) - zc * zc
    if d >= -1e-6 * zc * zc:
        return
    f = radius_squared / d
    mid_x, mid_y = f * (tu0 * tw0 + tu1 * tw1), f * (tv0 * tw0 + tv1 * tw1)
    outlines[i, at.MID_X], outlines[i, at.MID_Y] = mid_x, mid_y
    outlines[i, at.HALF_X] = math.sqrt(max(mid_x * mid_x - f * (tu0 * tu0 + tu1 * tu1), 0.0))
    outlines[i, at.HALF_Y] = math.sqrt(max(mid_y * mid_y - f * (tv0 * tv0 + tv1 * tv1), 0.0))
    outlines[i, at.COVARIANCE] = mid_x * mid_y - f * (tu0 * tv0 + tu1 * tv1)


@numba.njit(cache=True, forceinline=True, fastmath=_REORDERED)
def _box(splats, outlines, i, width_px, height_px, boxes):
    """Fill row i of boxes (N, 4) with the first and last column and row of pixels, half open, whose centres lie in the outline's bounds."""
    if outlines[i, at.HALF_X] == np.inf:
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = 0, width_px, 0, height_px
        return
    low_pass, mid_x, mid_y = outlines[i, at.LOW_PASS], outlines[i, at.MID_X], outlines[i, at.MID_Y]
    left, right = min(mid_x - outlines[i, at.HALF_X], -low_pass), max(mid_x + outlines[i, at.HALF_X], low_pass)
    top, bottom = min(mid_y - outlines[i, at.HALF_Y], -low_pass), max(mid_y + outlines[i, at.HALF_Y], low_pass)
    # Pixel j's centre is at j + 0.5; clamped in floating point, before the cast can overflow.
    boxes[i, 0] = int(min(max(math.ceil(splats[i, at.CX] + left - 0.5 - MARGIN_PX), 0.0), width_px))
    boxes[i, 1] = int(min(max(math.floor(splats[i, at.CX] + right + 0.5 + MARGIN_PX), 0.0), width_px))
    boxes[i, 2] = int(min(max(math.ceil(splats[i, at.CY] + top - 0.5 - MARGIN_PX), 0.0), height_px))
    boxes[i, 3] = int(min(max(math.floor(splats[i, at.CY] + bottom + 0.5 + MARGIN_PX), 0.0), height_px))


@numba.njit(cache=True, forceinline=True, fastmath=_REORDERED)
def _in_camera(positions, quaternions, i, camera, p, rotation, tangents):
    """Fill p (3,), rotation (3, 3) and tangents (3, 3): position, and as rows the two tangents and the normal, in the camera frame.

    Returns one over the quaternion's length and q, the cosine between normal and the ray to the centre times the ray's length.
    """
    for r in range(3):
        p[r] = camera[9 + r] + camera[3 * r] * positions[i, 0] + camera[3 * r + 1] * positions[i, 1] + camera[3 * r + 2] * positions[i, 2]
    inverse = rotation_of(quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3], rotation)
    for axis in range(3):
        for r in range(3):
            total = camera[3 * r] * rotation[0, axis] + camera[3 * r + 1] * rotation[1, axis]
            tangents[axis, r] = total + camera[3 * r + 2] * rotation[2, axis]
    return inverse, (tangents[2, 0] * p[0] + tangents[2, 1] * p[1] + tangents[2, 2] * p[2]) / p[2]


# Inlined by Numba, not by LLVM: within the loop, the compiler knows that the arrays do not overlap, and a third of the time is saved.
@numba.njit(inline="always", error_model="numpy", fastmath=_REORDERED)
def project_surfel(
    positions, log_scales, quaternions, opacity_logits, sh, i, degree, camera, width_px, height_px, near,
    p, rotation, tangents, basis, splats, outlines, boxes,
):  # fmt: skip
    """Surfel i of `project_forward`; p (3,), rotation (3, 3), tangents (3, 3) and basis (16,) float64 are overwritten."""
    fx, fy, cx0, cy0 = camera[12], camera[13], camera[14], camera[15]
    boxes[i, 0] = boxes[i, 1] = boxes[i, 2] = boxes[i, 3] = 0
    opacity = 1.0 / (1.0 + math.exp(-opacity_logits[i]))
    _, q = _in_camera(positions, quaternions, i, camera, p, rotation, tangents)
    if p[2] <= near or opacity <= ALPHA_MIN:
        return
    t, n0, n1, n2 = tangents, tangents[2, 0], tangents[2, 1], tangents[2, 2]
    su, sv = math.exp(log_scales[i, 0]), math.exp(log_scales[i, 1])
    splats[i, at.CX], splats[i, at.CY], splats[i, at.ZC] = fx * p[0] / p[2] + cx0, fy * p[1] / p[2] + cy0, p[2]
    if abs(q) > GRAZING_MIN:
        along_u = (t[0, 0] * p[0] + t[0, 1] * p[1] + t[0, 2] * p[2]) / q
        along_v = (t[1, 0] * p[0] + t[1, 1] * p[1] + t[1, 2] * p[2]) / q
        splats[i, at.U1], splats[i, at.U2] = (p[2] * t[0, 0] - along_u * n0) / (fx * su), (p[2] * t[0, 1] - along_u * n1) / (fy * su)
        splats[i, at.V1], splats[i, at.V2] = (p[2] * t[1, 0] - along_v * n0) / (fx * sv), (p[2] * t[1, 1] - along_v * n1) / (fy * sv)
        splats[i, at.A1], splats[i, at.A2] = n0 / (fx * q), n1 / (fy * q)
    else:
        splats[i, at.U1] = splats[i, at.V2] = 1e15
        splats[i, at.U2] = splats[i, at.V1] = splats[i, at.A1] = splats[i, at.A2] = 0.0
    facing = -1.0 if q > 0 else 1.0
    splats[i, at.NX], splats[i, at.NY], splats[i, at.NZ] = facing * n0, facing * n1, facing * n2
    splats[i, at.OPACITY] = opacity

    dx, dy, dz, _ = view_direction(positions, i, camera)
    sh_basis(degree, dx, dy, dz, basis)
    red = green = blue = 0.5
    for k in range((degree + 1) * (degree + 1)):
        red += basis[k] * sh[i, k, 0]
        green += basis[k] * sh[i, k, 1]
        blue += basis[k] * sh[i, k, 2]
    splats[i, at.RED], splats[i, at.GREEN], splats[i, at.BLUE] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
    radius_squared = 2.0 * math.log(opacity / ALPHA_MIN)
    _outline(p[2], fx, fy, cx0 - splats[i, at.CX], cy0 - splats[i, at.CY], su, sv, tangents, radius_squared, outlines, i)
    _box(splats, outlines, i, width_px, height_px, boxes)


@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath=_REORDERED)
def project_forward(
    positions, log_scales, quaternions, opacity_logits, sh, degree, camera, width_px, height_px, near, workers, splats, outlines, boxes
):
    """Project every surfel.

    Args:
        positions (N, 3), log_scales (N, 2), quaternions (N, 4; w first, any length), opacity_logits (N,), sh (N, 16, 3): float32.
        degree: spherical-harmonics degree in use, 0 to 3.
        camera (16,) float64: camera_from_world's rotation (9), translation (3), then fx, fy, cx, cy.
        near: surfels with a centre nearer than this are not drawn.
        splats (N, 16) float32: filled with the columns named above. Normals are in the camera frame and face the camera.
        outlines (N, 6) float32: filled with the columns named above, where drawn.
        boxes (N, 4) int32: filled with x0, x1, y0, y1 in pixels, half open; empty for surfels that are not drawn.
    """
    for worker in numba.prange(workers):
        p, rotation, tangents, basis = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty(16)
        for i in range(worker * len(positions) // workers, (worker + 1) * len(positions) // workers):
            project_surfel(
                positions, log_scales, quaternions, opacity_logits, sh, i, degree, camera, width_px, height_px, near,
                p, rotation, tangents, basis, splats, outlines, boxes,
            )  # fmt: skip


@numba.njit(inline="always", error_model="numpy", fastmath=_REORDERED)
def differentiate_surfel(
    positions, log_scales, quaternions, sh, i, degree, camera, splats, boxes, splat_gradients,
    p, rotation, tangents, basis, slopes, gp, gt, grotation,
    position_gradients, log_scale_gradients, quaternion_gradients, opacity_gradients, sh_gradients,
):  # fmt: skip
    """Surfel i of `project_backward`; the float64 arrays from p to grotation (3, 3), slopes (16, 3) among them, are overwritten."""
    fx, fy = camera[12], camera[13]
    if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
        return
    inverse, q = _in_camera(positions, quaternions, i, camera, p, rotation, tangents)
    _geometry_backward(log_scales, splats, splat_gradients, i, fx, fy, p, tangents, q, gp, gt, log_scale_gradients)
    for c in range(3):
        position_gradients[i, c] = camera[c] * gp[0] + camera[3 + c] * gp[1] + camera[6 + c] * gp[2]
        for axis in range(3):
            grotation[c, axis] = camera[c] * gt[axis, 0] + camera[3 + c] * gt[axis, 1] + camera[6 + c] * gt[axis, 2]
    _quaternion_backward(quaternions, i, inverse, grotation, quaternion_gradients)
    opacity = splats[i, at.OPACITY]
    opacity_gradients[i] = splat_gradients[i, at.OPACITY] * opacity * (1.0 - opacity)
    _color_backward(
        positions, sh, i, degree, camera, splats, splat_gradients, basis, slopes, position_gradients, sh_gradients
    )  # fmt: skip


@numba.njit(cache=True, parallel=True, error_model="numpy", fastmath=_REORDERED)
def project_backward(
    positions, log_scales, quaternions, sh, degree, camera, workers, splats, boxes, splat_gradients,
    position_gradients, log_scale_gradients, quaternion_gradients, opacity_gradients, sh_gradients,
):  # fmt: skip
    """Carry gradients of the splat columns (N, 16) back to the surfels' parameters, which must hold zeros."""
    for worker in numba.prange(workers):
        p, rotation, tangents, basis, slopes = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty(16), np.empty((16, 3))
        gp, gt, grotation = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        for i in range(worker * len(positions) // workers, (worker + 1) * len(positions) // workers):
            differentiate_surfel(
                positions, log_scales, quaternions, sh, i, degree, camera, splats, boxes, splat_gradients,
                p, rotation, tangents, basis, slopes, gp, gt, grotation,
                position_gradients, log_scale_gradients, quaternion_gradients, opacity_gradients, sh_gradients,
            )  # fmt: skip


@numba.njit(cache=True, forceinline=True, error_model="numpy", fastmath=_REORDERED)
def _geometry_backward(log_scales, splats, g, i, fx, fy, p, tangents, q, gp, gt, log_scale_gradients):
    """From row i of gradients g (N, 16) of the splats to gp (3,) of its centre and gt (3, 3) of its axes in the camera frame."""
    n0, n1, n2 = tangents[2, 0], tangents[2, 1], tangents[2, 2]
    g0, g1 = g[i, at.CX] * fx / p[2], g[i, at.CY] * fy / p[2]
    g2 = g[i, at.ZC] - (g[i, at.CX] * fx * p[0] + g[i, at.CY] * fy * p[1]) / (p[2] * p[2])
    facing = -1.0 if q > 0 else 1.0
    gn0, gn1, gn2 = facing * g[i, at.NX], facing * g[i, at.NY], facing * g[i, at.NZ]
    gq = 0.0
    for axis in range(2):
        gt[axis, 0] = gt[axis, 1] = gt[axis, 2] = 0.0
    if abs(q) > GRAZING_MIN:
        for axis in range(2):
            t0, t1, t2 = tangents[axis, 0], tangents[axis, 1], tangents[axis, 2]
            scale = math.exp(log_scales[i, axis])
            first = at.U1 + 2 * axis
            g_first, g_second = g[i, first] / (fx * scale), g[i, first + 1] / (fy * scale)
            along = (t0 * p[0] + t1 * p[1] + t2 * p[2]) / q
            dot = (g_first * n0 + g_second * n1) / q
            gn0 -= g_first * along
            gn1 -= g_second * along
            gq += along * dot
            gt[axis, 0] = g_first * p[2] - dot * p[0]
            gt[axis, 1] = g_second * p[2] - dot * p[1]
            gt[axis, 2] = -dot * p[2]
            g0 -= dot * t0
            g1 -= dot * t1
            g2 += g_first * t0 + g_second * t1 - dot * t2
            log_scale_gradients[i, axis] = -(g[i, first] * splats[i, first] + g[i, first + 1] * splats[i, first + 1])
        gn0 += g[i, at.A1] / (fx * q)
        gn1 += g[i, at.A2] / (fy * q)
        gq -= (g[i, at.A1] * splats[i, at.A1] + g[i, at.A2] * splats[i, at.A2]) / q
    gq /= p[2]
    gt[2, 0], gt[2, 1], gt[2, 2] = gn0 + gq * p[0], gn1 + gq * p[1], gn2 + gq * p[2]
    gp[0], gp[1], gp[2] = g0 + gq * n0, g1 + gq * n1, g2 + gq * (n2 - q)


@numba.njit(cache=True, forceinline=True, fastmath=_REORDERED)
def _quaternion_backward(quaternions, i, inverse, g, out):
    w, x, y, z = quaternions[i, 0] * inverse, quaternions[i, 1] * inverse, quaternions[i, 2] * inverse, quaternions[i, 3] * inverse
    gw = 2 * (x * (g[2, 1] - g[1, 2]) + y * (g[0, 2] - g[2, 0]) + z * (g[1, 0] - g[0, 1]))
    gx = 2 * (-2 * x * (g[1, 1] + g[2, 2]) + y * (g[1, 0] + g[0, 1]) + z * (g[2, 0] + g[0, 2]) + w * (g[2, 1] - g[1, 2]))
    gy = 2 * (x * (g[1, 0] + g[0, 1]) - 2 * y * (g[0, 0] + g[2, 2]) + z * (g[2, 1] + g[1, 2]) + w * (g[0, 2] - g[2, 0]))
    gz = 2 * (x * (g[2, 0] + g[0, 2]) + y * (g[2, 1] + g[1, 2]) - 2 * z * (g[0, 0] + g[1, 1]) + w * (g[1, 0] - g[0, 1]))
    along = gw * w + gx * x + gy * y + gz * z
    out[i, 0], out[i, 1] = (gw - along * w) * inverse, (gx - along * x) * inverse
    out[i, 2], out[i, 3] = (gy - along * y) * inverse, (gz - along * z) * inverse


@numba.njit(cache=True, forceinline=True, fastmath=_REORDERED)
def _color_backward(positions, sh, i, degree, camera, splats, g, basis, slopes, position_gradients, out):
    dx, dy, dz, length = view_direction(positions, i, camera)
    sh_basis(degree, dx, dy, dz, basis)
    sh_gradient(degree, dx, dy, dz, slopes)
    red = g[i, at.RED] if splats[i, at.RED] > 0.0 else 0.0
    green = g[i, at.GREEN] if splats[i, at.GREEN] > 0.0 else 0.0
    blue = g[i, at.BLUE] if splats[i, at.BLUE] > 0.0 else 0.0
    gx = gy = gz = 0.0
    for k in range((degree + 1) * (degree + 1)):
        out[i, k, 0], out[i, k, 1], out[i, k, 2] = red * basis[k], green * basis[k], blue * basis[k]
        along = red * sh[i, k, 0] + green * sh[i, k, 1] + blue * sh[i, k, 2]
        gx += along * slopes[k, 0]
        gy += along * slopes[k, 1]
        gz += along * slopes[k, 2]
    along = gx * dx + gy * dy + gz * dz
    position_gradients[i, 0] += (gx - along * dx) / length
    position_gradients[i, 1] += (gy - along * dy) / length
    position_gradients[i, 2] += (gz - along * dz) / length
