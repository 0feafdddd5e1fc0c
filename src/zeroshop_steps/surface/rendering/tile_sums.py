"""Sums over the pixels of a tile in the CUDA kernels of both renderers: in shared memory, in fixed order and without atomics."""

import numba

from zeroshop_steps.surface.rendering.tiling import TILE_PX


@numba.njit(inline="always")
def fold_row(values, column, first, largest):
    """The sum of the 16 values that begin at `first` in a row of values (16, K); their maximum, if the row is number `largest`."""
    total = values[column, first]
    for k in range(1, TILE_PX):
        value = values[column, first + k]
        total = max(total, value) if column == largest else total + value
    return total
