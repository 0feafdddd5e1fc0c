"""What rows, images and buffers of the kernels of 2D Gaussian Splatting hold, by column and by plane."""

import numba

from zeroshop_steps.surface.twodgs.kernels.intersection import HALF_SQRT

# Columns of a splat row, and of its gradient.
CX, CY, ZC, U1, U2, V1, V2, A1, A2, OPACITY, RED, GREEN, BLUE, NX, NY, NZ, SPLAT_WIDTH = range(17)
# Columns of an outline: the bounds of a splat's footprint on the image, all in pixels. The ellipse's centre relative to the
# projected one, its half extents and their covariance, that is, half_x times where along y it reaches farthest to the right,
# and the radius of the low-pass filter. HALF_X is infinite for a surfel that reaches the camera plane: it may be seen anywhere.
MID_X, MID_Y, HALF_X, HALF_Y, COVARIANCE, LOW_PASS, OUTLINE_WIDTH = range(7)
# Planes of the image that `blend_forward` fills: colour, depth, normal, opacity, median depth, and the distortion
# sum of eq. 13 with its first and second moments of the mapped depth.
(OUT_R, OUT_G, OUT_B, OUT_DEPTH, OUT_NX, OUT_NY, OUT_NZ, OUT_ALPHA, OUT_MEDIAN, OUT_DISTORTION, OUT_M1, OUT_M2, OUT_PLANES) = range(13)
GRAD_PLANES = OUT_M1
"""The planes before it have a gradient."""


@numba.njit(cache=True, forceinline=True)
def shape_of(splats, i):
    """What `intersect_surfel` asks of a splat: the projected centre, then the columns that it takes."""
    return (
        splats[i, CX], splats[i, CY], splats[i, U1] * HALF_SQRT, splats[i, U2] * HALF_SQRT, splats[i, V1] * HALF_SQRT,
        splats[i, V2] * HALF_SQRT, splats[i, A1], splats[i, A2],
    )  # fmt: skip


@numba.njit(cache=True, forceinline=True)
def look_of(splats, i):
    """Depth of the centre, opacity, colour and normal of a splat."""
    return (
        splats[i, ZC], splats[i, OPACITY], splats[i, RED], splats[i, GREEN], splats[i, BLUE], splats[i, NX], splats[i, NY], splats[i, NZ],
    )  # fmt: skip
