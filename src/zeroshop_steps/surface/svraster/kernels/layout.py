"""What rows, images and buffers of the kernels of sparse voxels hold, by column and by plane."""

import numba

# Columns of a voxel's row: reference pixel, A, B, C, least tau (the near plane), depth of the centre, edge, the
# polynomial's coefficients of 1, x, y, z, xy, xz, yz, xyz, colour, and unit normal in the camera frame.
X0, Y0, A0, A1, A2, B0, B1, B2, C0, C1, C2, TAU_MIN, ZC, SIZE = range(14)
P1, PX, PY, PZ, PXY, PXZ, PYZ, PXYZ = range(14, 22)
RED, GREEN, BLUE, NX, NY, NZ, ROW_WIDTH = range(22, 29)
# Columns of its gradient: the polynomial's, the colour's, the normal's, then largest blending weight and priority.
G_P, G_RED, G_NX, G_WEIGHT, G_PRIORITY, GRADIENT_WIDTH = 0, 8, 11, 14, 15, 16
# Planes of the image that `blend_forward` fills: colour, depth, normal, opacity, median depth, weighted square of the
# colour, weighted cosine of normals that face away, and, by-product, the median depth's change with optical thickness.
(OUT_R, OUT_G, OUT_B, OUT_DEPTH, OUT_NX, OUT_NY, OUT_NZ, OUT_ALPHA, OUT_MEDIAN, OUT_SQUARE, OUT_AWAY, OUT_SLOPE, OUT_PLANES) = range(13)
GRAD_PLANES = OUT_SLOPE
"""The planes before it have a gradient."""
# Planes of a block's buffer: pixel position, ray direction and its inverse, one over its length, thickness for each unit of
# depth, transmittance, thickness so far; then what a pass adds.
X, Y, D, R, LENGTH, THICK, T, SUM_X, OWN = 0, 1, 2, 5, 8, 9, 10, 11, 12


@numba.njit(cache=True, forceinline=True)
def box_of(rows, i):
    """What `intersect_voxel` asks of a voxel."""
    return (
        rows[i, X0], rows[i, Y0], rows[i, A0], rows[i, A1], rows[i, A2], rows[i, B0], rows[i, B1], rows[i, B2],
        rows[i, C0], rows[i, C1], rows[i, C2], rows[i, TAU_MIN],
    )  # fmt: skip


@numba.njit(cache=True, forceinline=True)
def polynomial_of(rows, i):
    """What `interpolate_density` asks of a voxel."""
    return rows[i, P1], rows[i, PX], rows[i, PY], rows[i, PZ], rows[i, PXY], rows[i, PXZ], rows[i, PYZ], rows[i, PXYZ]


@numba.njit(cache=True, forceinline=True)
def look_of(rows, i):
    """Depth of the centre, edge, colour and normal of a voxel."""
    return rows[i, ZC], rows[i, SIZE], rows[i, RED], rows[i, GREEN], rows[i, BLUE], rows[i, NX], rows[i, NY], rows[i, NZ]
