import numpy as np
import pytest

from zeroshop_steps.geometry.cholesky import solve_by_cholesky


@pytest.mark.parametrize("size", [1, 2, 6, 49])
def test_a_positive_definite_system_is_solved(size):
    rng = np.random.default_rng(size)
    rows = rng.normal(size=(2 * size, size))
    square, right = rows.T @ rows, rng.normal(size=size)
    found = right.copy()
    solve_by_cholesky(square.copy(), found)
    np.testing.assert_allclose(found, np.linalg.solve(square, right), rtol=1e-9)
