"""Small systems of equations, for kernels: `np.linalg.solve` takes seconds to compile."""

import numba
import numpy as np


@numba.njit(cache=True, forceinline=True)
def solve_by_cholesky(square: np.ndarray, right: np.ndarray) -> None:
    """Replace (n,) `right` by the solution of a positive definite (n, n) system, whose lower triangle is replaced by its factor."""
    count = len(right)
    for j in range(count):
        for i in range(j, count):
            value = square[i, j]
            for k in range(j):
                value -= square[i, k] * square[j, k]
            square[i, j] = np.sqrt(value) if i == j else value / square[j, j]
    for i in range(count):
        for k in range(i):
            right[i] -= square[i, k] * right[k]
        right[i] /= square[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            right[i] -= square[k, i] * right[k]
        right[i] /= square[i, i]
