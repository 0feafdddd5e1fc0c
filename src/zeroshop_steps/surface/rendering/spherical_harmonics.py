"""Colour that changes with the viewing direction: real spherical harmonics up to degree 3 (as in Kerbl et al. 2023)."""

import math

import numba

SH_CONSTANT = 0.5 / math.sqrt(math.pi)
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
_C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


@numba.njit(cache=True, forceinline=True)
def sh_basis(degree, x, y, z, basis):
    """Fill basis (16,) with the real spherical harmonics at the unit direction, as far as the degree goes."""
    basis[0] = SH_CONSTANT
    if degree < 1:
        return
    basis[1], basis[2], basis[3] = -_C1 * y, _C1 * z, -_C1 * x
    if degree < 2:
        return
    xx, yy, zz = x * x, y * y, z * z
    basis[4], basis[5], basis[6] = _C2[0] * x * y, _C2[1] * y * z, _C2[2] * (2.0 * zz - xx - yy)
    basis[7], basis[8] = _C2[3] * x * z, _C2[4] * (xx - yy)
    if degree < 3:
        return
    basis[9], basis[10] = _C3[0] * y * (3.0 * xx - yy), _C3[1] * x * y * z
    basis[11], basis[12] = _C3[2] * y * (4.0 * zz - xx - yy), _C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)
    basis[13], basis[14] = _C3[4] * x * (4.0 * zz - xx - yy), _C3[5] * z * (xx - yy)
    basis[15] = _C3[6] * x * (xx - 3.0 * yy)


@numba.njit(cache=True, forceinline=True)
def sh_gradient(degree, x, y, z, gradient):
    """Fill gradient (16, 3) with the derivatives of `sh_basis` by the direction."""
    gradient[0, 0] = gradient[0, 1] = gradient[0, 2] = 0.0
    if degree < 1:
        return
    gradient[1:4] = 0.0
    gradient[1, 1], gradient[2, 2], gradient[3, 0] = -_C1, _C1, -_C1
    if degree < 2:
        return
    xx, yy, zz = x * x, y * y, z * z
    gradient[4, 0], gradient[4, 1], gradient[4, 2] = _C2[0] * y, _C2[0] * x, 0.0
    gradient[5, 0], gradient[5, 1], gradient[5, 2] = 0.0, _C2[1] * z, _C2[1] * y
    gradient[6, 0], gradient[6, 1], gradient[6, 2] = -2.0 * _C2[2] * x, -2.0 * _C2[2] * y, 4.0 * _C2[2] * z
    gradient[7, 0], gradient[7, 1], gradient[7, 2] = _C2[3] * z, 0.0, _C2[3] * x
    gradient[8, 0], gradient[8, 1], gradient[8, 2] = 2.0 * _C2[4] * x, -2.0 * _C2[4] * y, 0.0
    if degree < 3:
        return
    gradient[9, 0], gradient[9, 1], gradient[9, 2] = 6.0 * _C3[0] * x * y, _C3[0] * (3.0 * xx - 3.0 * yy), 0.0
    gradient[10, 0], gradient[10, 1], gradient[10, 2] = _C3[1] * y * z, _C3[1] * x * z, _C3[1] * x * y
    gradient[11, 0], gradient[11, 1], gradient[11, 2] = -2.0 * _C3[2] * x * y, _C3[2] * (4.0 * zz - xx - 3.0 * yy), 8.0 * _C3[2] * y * z
    gradient[12, 0], gradient[12, 1] = -6.0 * _C3[3] * x * z, -6.0 * _C3[3] * y * z
    gradient[12, 2] = _C3[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy)
    gradient[13, 0], gradient[13, 1], gradient[13, 2] = _C3[4] * (4.0 * zz - 3.0 * xx - yy), -2.0 * _C3[4] * x * y, 8.0 * _C3[4] * x * z
    gradient[14, 0], gradient[14, 1], gradient[14, 2] = 2.0 * _C3[5] * x * z, -2.0 * _C3[5] * y * z, _C3[5] * (xx - yy)
    gradient[15, 0], gradient[15, 1], gradient[15, 2] = _C3[6] * (3.0 * xx - 3.0 * yy), -6.0 * _C3[6] * x * y, 0.0


@numba.njit(cache=True, inline="always")
def camera_centre(camera, axis):
    """Coordinate of the centre of a camera row (16,) along one axis of the world."""
    return -(camera[axis] * camera[9] + camera[3 + axis] * camera[10] + camera[6 + axis] * camera[11])


@numba.njit(cache=True, inline="always")
def view_direction(points, i, camera):
    """Unit direction from the centre of a camera row (16,) to row i of points (N, 3), in the world frame, and the distance."""
    x, y, z = points[i, 0] - camera_centre(camera, 0), points[i, 1] - camera_centre(camera, 1), points[i, 2] - camera_centre(camera, 2)
    length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    return x / length, y / length, z / length, length
