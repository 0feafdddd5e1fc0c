"""From surfels in the world to splats on the image: the projection of 2D Gaussian Splatting, forward and backward.

A surfel is a planar Gaussian disk with centre p, unit tangents t_u, t_v and scales s_u, s_v (Huang et al. 2024, eq. 4).
The pixel ray through (x, y) meets its plane at local coordinates (u, v), a projective map of the pixel (eq. 8 to 10).
Written around the projected centre c = (c_x, c_y), with dx = x - c_x and dy = y - c_y, that map has no constant term:

    a = 1 + a_1 dx + a_2 dy,   u = (u_1 dx + u_2 dy) / a,   v = (v_1 dx + v_2 dy) / a,   z = z_c / a

so nine numbers describe the disk exactly, and nothing cancels far from the image's origin in single precision.
Appearance is a real spherical-harmonics expansion up to degree 3 in the viewing direction (Kerbl et al. 2023).
"""

import math

import numba
import numpy as np

from zeroshop_steps.nvs.harmonics import sh_basis, view_direction

# Columns of a splat row, and of its gradient.
CX, CY, ZC, U1, U2, V1, V2, A1, A2, OPACITY, RED, GREEN, BLUE, NX, NY, NZ = range(16)
SPLAT_WIDTH = 16

ALPHA_MIN = 1.0 / 255.0
"""Contributions below one grey level are skipped, and end a splat's footprint."""
GRAZING_MIN = 1e-7
"""Sine of the angle between ray and disk below which only the low-pass filter draws the disk."""


@numba.njit(cache=True)
def rotation_of(w, x, y, z, rotation):
    """Fill rotation (3, 3) from a quaternion of any length; returns one over the length."""
    inverse = 1.0 / max(math.sqrt(w * w + x * x + y * y + z * z), 1e-12)
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return inverse


@numba.njit(cache=True)
def _half_extents(splat_zc, fx, fy, kx, ky, tangents_su, tangents_sv, radius_squared, box):
    """Fill box (4,) with x0, x1, y0, y1 around the projected centre; False when the disk reaches the camera plane.

    tangents_su, tangents_sv: camera-space tangents times their scales; kx, ky: principal point relative to the centre.
    The box is that of the projected ellipse u^2 + v^2 = radius_squared (Weyrich et al. 2007, as used in 2DGS, sec. 4.2).
    """
    tu0, tu1 = fx * tangents_su[0] + kx * tangents_su[2], fx * tangents_sv[0] + kx * tangents_sv[2]
    tv0, tv1 = fy * tangents_su[1] + ky * tangents_su[2], fy * tangents_sv[1] + ky * tangents_sv[2]
    tw0, tw1 = tangents_su[2], tangents_sv[2]
    d = radius_squared * (tw0 * tw0 + tw1 * tw1) - splat_zc * splat_zc
    if d >= -1e-6 * splat_zc * splat_zc:
        return False
    f = radius_squared / d
    mid_x, mid_y = f * (tu0 * tw0 + tu1 * tw1), f * (tv0 * tw0 + tv1 * tw1)
    half_x = math.sqrt(max(mid_x * mid_x - f * (tu0 * tu0 + tu1 * tu1), 0.0))
    half_y = math.sqrt(max(mid_y * mid_y - f * (tv0 * tv0 + tv1 * tv1), 0.0))
    low_pass = math.sqrt(0.5 * radius_squared)
    box[0], box[1] = min(mid_x - half_x, -low_pass), max(mid_x + half_x, low_pass)
    box[2], box[3] = min(mid_y - half_y, -low_pass), max(mid_y + half_y, low_pass)
    return True


@numba.njit(cache=True, parallel=True, error_model="numpy")
def project_forward(positions, log_scales, quaternions, opacity_logits, sh, degree, camera, width_px, height_px, near, splats, boxes):
    """Project every surfel.

    Args:
        positions (N, 3), log_scales (N, 2), quaternions (N, 4; w first, any length), opacity_logits (N,), sh (N, 16, 3): float32.
        degree: spherical-harmonics degree in use, 0 to 3.
        camera (16,) float64: camera_from_world's rotation (9), translation (3), then fx, fy, cx, cy.
        near: surfels with a centre nearer than this are not drawn.
        splats (N, 16) float32: filled with the columns named above. Normals are in the camera frame and face the camera.
        boxes (N, 4) int32: filled with x0, x1, y0, y1 in pixels, half open; empty for surfels that are not drawn.
    """
    fx, fy, cx0, cy0 = camera[12], camera[13], camera[14], camera[15]
    for i in numba.prange(len(positions)):
        boxes[i] = 0
        basis, gradient = np.empty(16), np.empty((16, 3))
        rotation, tangents, box = np.empty((3, 3)), np.empty((3, 3)), np.empty(4)
        p = np.empty(3)
        for r in range(3):
            p[r] = camera[9 + r]
            for c in range(3):
                p[r] += camera[3 * r + c] * positions[i, c]
        opacity = 1.0 / (1.0 + math.exp(-opacity_logits[i]))
        if p[2] <= near or opacity <= ALPHA_MIN:
            continue
        rotation_of(quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3], rotation)
        for axis in range(3):
            for r in range(3):
                tangents[axis, r] = 0.0
                for c in range(3):
                    tangents[axis, r] += camera[3 * r + c] * rotation[c, axis]
        tu, tv, n = tangents[0], tangents[1], tangents[2]
        su, sv = math.exp(log_scales[i, 0]), math.exp(log_scales[i, 1])
        q = (n[0] * p[0] + n[1] * p[1] + n[2] * p[2]) / p[2]
        splats[i, CX], splats[i, CY], splats[i, ZC] = fx * p[0] / p[2] + cx0, fy * p[1] / p[2] + cy0, p[2]
        if abs(q) > GRAZING_MIN:
            along_u = (tu[0] * p[0] + tu[1] * p[1] + tu[2] * p[2]) / q
            along_v = (tv[0] * p[0] + tv[1] * p[1] + tv[2] * p[2]) / q
            splats[i, U1], splats[i, U2] = (p[2] * tu[0] - along_u * n[0]) / (fx * su), (p[2] * tu[1] - along_u * n[1]) / (fy * su)
            splats[i, V1], splats[i, V2] = (p[2] * tv[0] - along_v * n[0]) / (fx * sv), (p[2] * tv[1] - along_v * n[1]) / (fy * sv)
            splats[i, A1], splats[i, A2] = n[0] / (fx * q), n[1] / (fy * q)
        else:
            splats[i, U1] = splats[i, V2] = 1e15
            splats[i, U2] = splats[i, V1] = splats[i, A1] = splats[i, A2] = 0.0
        facing = -1.0 if q > 0 else 1.0
        splats[i, NX], splats[i, NY], splats[i, NZ] = facing * n[0], facing * n[1], facing * n[2]
        splats[i, OPACITY] = opacity

        dx, dy, dz, _ = view_direction(positions[i], camera)
        sh_basis(degree, dx, dy, dz, basis, gradient)
        for channel in range(3):
            value = 0.5
            for k in range((degree + 1) * (degree + 1)):
                value += basis[k] * sh[i, k, channel]
            splats[i, RED + channel] = max(value, 0.0)

        for r in range(3):
            tu[r] *= su
            tv[r] *= sv
        radius_squared = 2.0 * math.log(opacity / ALPHA_MIN)
        kx, ky = cx0 - splats[i, CX], cy0 - splats[i, CY]
        if _half_extents(p[2], fx, fy, kx, ky, tu, tv, radius_squared, box):
            # Pixel j's centre is at j + 0.5, hence the shift; clamped in floating point, before the cast can overflow.
            boxes[i, 0] = int(min(max(math.floor(splats[i, CX] + box[0] - 0.5), 0.0), width_px))
            boxes[i, 1] = int(min(max(math.ceil(splats[i, CX] + box[1] + 0.5), 0.0), width_px))
            boxes[i, 2] = int(min(max(math.floor(splats[i, CY] + box[2] - 0.5), 0.0), height_px))
            boxes[i, 3] = int(min(max(math.ceil(splats[i, CY] + box[3] + 0.5), 0.0), height_px))
        else:
            boxes[i, 1], boxes[i, 3] = width_px, height_px


@numba.njit(cache=True, parallel=True, error_model="numpy")
def project_backward(
    positions, log_scales, quaternions, sh, degree, camera, splats, boxes, splat_gradients,
    position_gradients, log_scale_gradients, quaternion_gradients, opacity_gradients, sh_gradients,
):  # fmt: skip
    """Carry gradients of the splat columns (N, 16) back to the surfels' parameters; every output is overwritten."""
    fx, fy = camera[12], camera[13]
    for i in numba.prange(len(positions)):
        position_gradients[i] = 0.0
        log_scale_gradients[i] = 0.0
        quaternion_gradients[i] = 0.0
        opacity_gradients[i] = 0.0
        sh_gradients[i] = 0.0
        if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
            continue
        g = splat_gradients[i]
        rotation, tangents = np.empty((3, 3)), np.empty((3, 3))
        p, gp, gt = np.empty(3), np.zeros(3), np.zeros((3, 3))
        for r in range(3):
            p[r] = camera[9 + r]
            for c in range(3):
                p[r] += camera[3 * r + c] * positions[i, c]
        inverse = rotation_of(quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3], rotation)
        for axis in range(3):
            for r in range(3):
                tangents[axis, r] = 0.0
                for c in range(3):
                    tangents[axis, r] += camera[3 * r + c] * rotation[c, axis]
        n = tangents[2]
        q = (n[0] * p[0] + n[1] * p[1] + n[2] * p[2]) / p[2]
        gq = 0.0
        if abs(q) > GRAZING_MIN:
            for axis in range(2):
                t = tangents[axis]
                scale = math.exp(log_scales[i, axis])
                first = U1 + 2 * axis
                g1, g2 = g[first] / (fx * scale), g[first + 1] / (fy * scale)
                along = t[0] * p[0] + t[1] * p[1] + t[2] * p[2]
                dot = g1 * n[0] + g2 * n[1]
                gt[axis, 0] += g1 * p[2]
                gt[axis, 1] += g2 * p[2]
                gp[2] += g1 * t[0] + g2 * t[1]
                gt[2, 0] -= g1 * along / q
                gt[2, 1] -= g2 * along / q
                gq += along * dot / (q * q)
                for r in range(3):
                    gt[axis, r] -= dot / q * p[r]
                    gp[r] -= dot / q * t[r]
                log_scale_gradients[i, axis] = -(g[first] * splats[i, first] + g[first + 1] * splats[i, first + 1])
            gt[2, 0] += g[A1] / (fx * q)
            gt[2, 1] += g[A2] / (fy * q)
            gq -= (g[A1] * splats[i, A1] + g[A2] * splats[i, A2]) / q
        for r in range(3):
            gt[2, r] += gq * p[r] / p[2]
            gp[r] += gq * n[r] / p[2]
        gp[2] -= gq * q / p[2]
        gp[0] += g[CX] * fx / p[2]
        gp[1] += g[CY] * fy / p[2]
        gp[2] += g[ZC] - (g[CX] * fx * p[0] + g[CY] * fy * p[1]) / (p[2] * p[2])
        facing = -1.0 if q > 0 else 1.0
        for r in range(3):
            gt[2, r] += facing * g[NX + r]

        for c in range(3):
            for r in range(3):
                position_gradients[i, c] += camera[3 * r + c] * gp[r]
        grotation = np.zeros((3, 3))
        for c in range(3):
            for axis in range(3):
                for r in range(3):
                    grotation[c, axis] += camera[3 * r + c] * gt[axis, r]
        _quaternion_backward(quaternions[i], inverse, grotation, quaternion_gradients[i])

        opacity = splats[i, OPACITY]
        opacity_gradients[i] = g[OPACITY] * opacity * (1.0 - opacity)
        _color_backward(positions[i], sh[i], degree, camera, splats[i], g, position_gradients[i], sh_gradients[i])


@numba.njit(cache=True)
def _quaternion_backward(quaternion, inverse, g, out):
    w, x, y, z = quaternion[0] * inverse, quaternion[1] * inverse, quaternion[2] * inverse, quaternion[3] * inverse
    gw = 2 * (x * (g[2, 1] - g[1, 2]) + y * (g[0, 2] - g[2, 0]) + z * (g[1, 0] - g[0, 1]))
    gx = 2 * (-2 * x * (g[1, 1] + g[2, 2]) + y * (g[1, 0] + g[0, 1]) + z * (g[2, 0] + g[0, 2]) + w * (g[2, 1] - g[1, 2]))
    gy = 2 * (x * (g[1, 0] + g[0, 1]) - 2 * y * (g[0, 0] + g[2, 2]) + z * (g[2, 1] + g[1, 2]) + w * (g[0, 2] - g[2, 0]))
    gz = 2 * (x * (g[2, 0] + g[0, 2]) + y * (g[2, 1] + g[1, 2]) - 2 * z * (g[0, 0] + g[1, 1]) + w * (g[1, 0] - g[0, 1]))
    along = gw * w + gx * x + gy * y + gz * z
    out[0], out[1] = (gw - along * w) * inverse, (gx - along * x) * inverse
    out[2], out[3] = (gy - along * y) * inverse, (gz - along * z) * inverse


@numba.njit(cache=True)
def _color_backward(position, sh, degree, camera, splat, g, position_gradient, sh_gradient):
    basis, gradient, gdirection = np.empty(16), np.empty((16, 3)), np.zeros(3)
    dx, dy, dz, length = view_direction(position, camera)
    sh_basis(degree, dx, dy, dz, basis, gradient)
    for channel in range(3):
        if splat[RED + channel] <= 0.0:
            continue
        for k in range((degree + 1) * (degree + 1)):
            sh_gradient[k, channel] = g[RED + channel] * basis[k]
            for c in range(3):
                gdirection[c] += g[RED + channel] * sh[k, channel] * gradient[k, c]
    along = gdirection[0] * dx + gdirection[1] * dy + gdirection[2] * dz
    position_gradient[0] += (gdirection[0] - along * dx) / length
    position_gradient[1] += (gdirection[1] - along * dy) / length
    position_gradient[2] += (gdirection[2] - along * dz) / length
