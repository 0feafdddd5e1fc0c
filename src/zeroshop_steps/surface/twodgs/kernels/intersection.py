"""Where the ray of a pixel meets a surfel, in single precision. Inlined into the loops of every kernel that draws."""

import numba
import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

_ONE = np.float32(1.0)
_FAR = np.float32(1e30)
_A_MIN = np.float32(1e-6)
HALF_SQRT = np.float32(np.sqrt(0.5))
"""Factor of u_1, u_2, v_1 and v_2 that turns u^2 + v^2 into the exponent."""

# exp(-x) = (exp(ln 2 - x / 4) / 2)^4: the argument stays within +-0.72, where a polynomial of degree 6 is good to 1e-6.
_FARTHEST, _MINUS_QUARTER, _LN2 = np.float32(5.65), np.float32(-0.25), np.float32(np.log(2.0))
_E0, _E1, _E2, _E3, _E4, _E5, _E6 = (
    Chebyshev.interpolate(lambda t: 0.5 * np.exp(t), 6, [-0.72, 0.7]).convert(kind=Polynomial).coef.astype(np.float32)
)


@numba.njit(inline="always", fastmath=True)
def exp_negative(x):
    """exp(-x) for x in [0, 5.65]; larger x give exp(-5.65), which lies below every cut."""
    t = min(x, _FARTHEST) * _MINUS_QUARTER + _LN2
    y = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * _E6)))))
    y = y * y
    return y * y


@numba.njit(inline="always", fastmath=True)
def intersect_surfel(dx, dy, u1, u2, v1, v2, a1, a2):
    """Where the ray of a pixel, (dx, dy) from the projected centre, meets the surfel, or its low-pass filter where that is nearer.

    u1, u2, v1, v2: columns of the splat times HALF_SQRT.

    Returns:
        on_surfel: whether the surfel counts, not the filter.
        a and r = 1 / a: both 1 where the filter counts; the depth is r times that of the centre.
        u, v: local coordinates times HALF_SQRT, and the sum of their squares; and the Gaussian's value.
    """
    a = _ONE + a1 * dx + a2 * dy
    ahead = a > _A_MIN
    r = _ONE / (a if ahead else _ONE)
    u = (u1 * dx + u2 * dy) * r
    v = (v1 * dx + v2 * dy) * r
    at_surfel = u * u + v * v if ahead else _FAR
    at_pixel = dx * dx + dy * dy
    on_surfel = at_surfel <= at_pixel
    return on_surfel, a if on_surfel else _ONE, r if on_surfel else _ONE, u, v, at_surfel, exp_negative(min(at_surfel, at_pixel))
