"""Where the ray of a pixel meets a voxel, the density there, and exponentials, in single precision: inlined into the kernels."""

import numba
import numpy as np

_ONE, _HALF, _TWO, _ZERO = np.float32(1.0), np.float32(0.5), np.float32(2.0), np.float32(0.0)
# exp(x) = exp(x / 16)^16 with a Taylor polynomial of degree 8: to 1e-7 where x > -8, and exact at zero.
_LOWEST, _SIXTEENTH = np.float32(-16.0), np.float32(1 / 16)
_E2, _E3, _E4, _E5 = np.float32(1 / 2), np.float32(1 / 6), np.float32(1 / 24), np.float32(1 / 120)
_E6, _E7, _E8 = np.float32(1 / 720), np.float32(1 / 5040), np.float32(1 / 40320)

SAMPLES = 2
"""Samples K of the density on each segment."""
DENSITY_SCALE = 100.0
"""Optical thickness, for each normalized unit of length, of an activated value of one."""
LINEAR_FROM = 1.1
"""Value from which the activation is linear (Sun et al. 2025, eq. 3)."""
_KNEE, _INVERSE_KNEE, _STEP = np.float32(LINEAR_FROM), np.float32(1.0 / LINEAR_FROM), np.float32(1.0 / SAMPLES)


@numba.njit(inline="always", fastmath=True)
def expm1(x):
    """exp(x) - 1 for x in [-16, 0], precise near zero too: a voxel that a ray misses stops no light; smaller x give that of -16."""
    t = max(x, _LOWEST) * _SIXTEENTH
    y = t * (_ONE + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    y = y * (y + _TWO)
    y = y * (y + _TWO)
    y = y * (y + _TWO)
    return y * (y + _TWO)


@numba.njit(inline="always", fastmath=True)
def exp(x):
    """exp(x) for x in [-16, 0]; smaller x give exp(-16)."""
    t = max(x, _LOWEST) * _SIXTEENTH
    y = _ONE + t * (_ONE + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * (_E6 + t * (_E7 + t * _E8)))))))
    y = y * y
    y = y * y
    y = y * y
    return y * y


@numba.njit(inline="always", fastmath=True)
def intersect_voxel(x, y, d0, d1, d2, r0, r1, r2, x0, y0, a0, a1, a2, b0, b1, b2, c0, c1, c2, tau_min):
    """Where a ray meets a voxel: the point e at the depth of its centre, the first tau, and the segment's length in tau, 0 for a miss."""
    dx, dy = x - x0, y - y0
    e0, e1, e2 = c0 + a0 * dx + b0 * dy, c1 + a1 * dx + b1 * dy, c2 + a2 * dx + b2 * dy
    m0, m1, m2 = -e0 * r0, -e1 * r1, -e2 * r2
    h0, h1, h2 = abs(r0) * _HALF, abs(r1) * _HALF, abs(r2) * _HALF
    first = max(max(m0 - h0, m1 - h1), max(m2 - h2, tau_min))
    last = min(min(m0 + h0, m1 + h1), m2 + h2)
    return e0, e1, e2, first, max(last - first, _ZERO)


@numba.njit(inline="always", fastmath=True)
def interpolate_density(u, v, w, p1, px, py, pz, pxy, pxz, pyz, pxyz):
    return p1 + px * u + v * (py + pxy * u) + w * (pz + pxz * u + v * (pyz + pxyz * u))


@numba.njit(inline="always", fastmath=True)
def sample_at(tau, length, k):
    """Where sample k of a segment lies, in tau."""
    return tau + length * ((np.float32(k) + _HALF) * _STEP)


@numba.njit(inline="always", fastmath=True)
def activate(v):
    """Exponential-linear activation of an interpolated value (Sun et al. 2025, eq. 3)."""
    return v if v > _KNEE else _KNEE * exp(v * _INVERSE_KNEE - _ONE)


@numba.njit(inline="always", fastmath=True)
def activation_slope(v):
    """The derivative of `activate`."""
    return _ONE if v > _KNEE else exp(v * _INVERSE_KNEE - _ONE)


@numba.njit(inline="always", fastmath=True)
def sum_densities(e0, e1, e2, tau, length, d0, d1, d2, p1, px, py, pz, pxy, pxz, pyz, pxyz):
    """Sum of the activated densities at a segment's samples."""
    total = _ZERO
    for k in range(SAMPLES):
        place = sample_at(tau, length, k)
        v = interpolate_density(e0 + place * d0, e1 + place * d1, e2 + place * d2, p1, px, py, pz, pxy, pxz, pyz, pxyz)
        total += activate(v)
    return total
