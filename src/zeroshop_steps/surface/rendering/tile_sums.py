"""Sums over the pixels of a tile, in fixed order and without atomics, so that they have the same bytes every run."""

import numba
import numpy as np

from zeroshop_steps.surface.rendering.tiling import LANES, TILE_PX, ZERO

SHARED_ROWS = 64
"""Rows of primitives that a block of a CUDA kernel reads into shared memory at once."""
NO_MAXIMUM = -1
"""In place of the number of the row whose maximum is asked for: all are summed."""


@numba.njit(inline="always")
def fold_row(values, column, first, largest):
    """The sum of the 16 values that begin at `first` in a row of values (16, K); their maximum, if the row is number `largest`."""
    total = values[column, first]
    for k in range(1, TILE_PX):
        value = values[column, first + k]
        total = max(total, value) if column == largest else total + value
    return total


@numba.njit(cache=True, forceinline=True, fastmath=True)
def take_sums(sums, largest, totals):
    """Fill totals (K,) with the sums, in number `largest` the maximum, of the lanes of a block in sums (16 K,); leaves zeros there."""
    for column in range(len(totals)):
        first = np.uint64(column * LANES)
        total = ZERO
        if column == largest:
            for lane in range(np.uint64(LANES)):
                total = max(total, sums[first + lane])
        else:
            for lane in range(np.uint64(LANES)):
                total += sums[first + lane]
        for lane in range(np.uint64(LANES)):
            sums[first + lane] = ZERO
        totals[column] = total
