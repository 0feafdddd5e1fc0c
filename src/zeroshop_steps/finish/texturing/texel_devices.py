"""Colours of texels on the processor or on a CUDA device."""

from typing import Protocol

import numpy as np

from zeroshop_steps.finish.texturing.texel_colors import CpuTexelColors, VotingView
from zeroshop_steps.runtime.compute.kernel_devices import choose_kernel_device


class TexelColors(Protocol):
    """Weighted sums of colours at N texels, which views add to."""

    def begin_round(self, least_votes: float, covered: float) -> None:
        """From now on, views add to texels with less weight than `covered`, where their votes exceed `least_votes`."""

    def add(self, view: VotingView) -> None:
        """Add a view's colours where it is trusted and nothing hides the texel."""

    def finish(self, broad: np.ndarray, broad_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """The mean colours (N, 3) uint8, and the weights (N,) float32 of the views; `broad` (V, 3) float32 weighs `broad_weight`."""


def make_texel_colors(device: str, corners: np.ndarray, shares: np.ndarray, vertices: np.ndarray, tolerance: float) -> TexelColors:
    """Sums on one of cpu, cuda and auto, as `choose_kernel_device` chooses; raises what it raises.

    Args:
        corners: (N, 3) int32 vertices of the face at each texel.
        shares: (N, 3) float32 of these vertices at the texel.
        vertices: (V, 3) float64.
        tolerance: a texel may lie so far behind the depth that a view sees.
    """
    if choose_kernel_device(device) == "cpu":
        return CpuTexelColors(corners, shares, vertices, tolerance)
    from zeroshop_steps.finish.texturing.cuda_texels import CudaTexelColors  # Numba's CUDA is loaded where it is used alone

    return CudaTexelColors(corners, shares, vertices, tolerance)
