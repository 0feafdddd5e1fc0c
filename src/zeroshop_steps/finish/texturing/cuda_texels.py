"""The colours of texels on a CUDA device, a thread for each texel. See texel_colors.py.

A view after the other is copied to the device, since all of a capture's photos may not fit. A thread alone writes the sums of its texel, in
the order of the views, so the result has the same bytes every run.

Without a GPU, Numba's simulator runs these kernels (NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1, before Numba is imported).
"""

import numpy as np
from numba import cuda

from zeroshop_steps.finish.texturing.texel_colors import VotingView, add_view, take_mean
from zeroshop_steps.geometry.rendering.cuda_rasterization import THREADS


class CudaTexelColors:
    """See `TexelColors`."""

    def __init__(self, corners: np.ndarray, shares: np.ndarray, vertices: np.ndarray, tolerance: float) -> None:
        self._count, self._tolerance = len(corners), tolerance
        self._texels = [cuda.to_device(array) for array in (corners, shares, vertices)]
        sums = (np.ones(len(corners), np.bool_), np.zeros((len(corners), 3), np.float32), np.zeros(len(corners), np.float32))
        self._open, self._color, self._weight = (cuda.to_device(array) for array in sums)
        self._least_votes = 0.0

    def begin_round(self, least_votes: float, covered: float) -> None:
        """See `TexelColors`."""
        self._least_votes = least_votes
        _find_open[self._grid(), THREADS](self._weight, covered, self._open)

    def add(self, view: VotingView) -> None:
        """See `TexelColors`."""
        parts = (view.projection, view.image, view.trust, view.depth, view.votes, view.corrections)
        limits, sums = (self._tolerance, self._least_votes), (self._open, self._color, self._weight)
        _add_view[self._grid(), THREADS](*self._texels, *(cuda.to_device(part) for part in parts), *limits, *sums)
        cuda.synchronize()

    def finish(self, broad: np.ndarray, broad_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """See `TexelColors`."""
        mean = cuda.to_device(np.zeros((self._count, 3), np.uint8))
        corners, shares, _ = self._texels
        _take_mean[self._grid(), THREADS](corners, shares, cuda.to_device(broad), np.float32(broad_weight), self._color, self._weight, mean)
        return np.asarray(mean.copy_to_host()), np.asarray(self._weight.copy_to_host())

    def _grid(self) -> int:
        return -(-self._count // THREADS)


@cuda.jit
def _find_open(weight, covered, is_open):
    """Which texels have less weight than `covered`."""
    i = cuda.grid(1)
    if i < len(weight):
        is_open[i] = weight[i] < covered


@cuda.jit
def _add_view(
    corners, shares, vertices, projection, image, trust, depth, votes, corrections, tolerance, least_votes, is_open, color, weight
):
    """`add_view`, each thread at its texels."""
    add_view(
        cuda.grid(1), cuda.gridsize(1), corners, shares, vertices, projection, image, trust, depth, votes, corrections,
        tolerance, least_votes, is_open, color, weight,
    )  # fmt: skip


@cuda.jit
def _take_mean(corners, shares, broad, broad_weight, color, weight, mean):
    """`take_mean`, each thread at its texels."""
    take_mean(cuda.grid(1), cuda.gridsize(1), corners, shares, broad, broad_weight, color, weight, mean)
