"""The colour of each texel from the photos that see it: one function for the processor and for CUDA (cuda_texels.py).

A view after the other adds its part to all texels, so that only one photo at a time is needed, and a texel's sum has one order. Positions
are calculated in double precision and colours in single, on both.
"""

from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np

from zeroshop_steps.runtime.compute.kernel_devices import choose_kernel_device


@dataclass(frozen=True)
class VotingView:
    """What a view says of the surface. V is the number of vertices.

    Attributes:
        projection: (3, 4) float64, from points to pixel positions and depth, both times the depth.
        image: (H, W, 3) float32 colours, 0 to 1.
        trust, depth: (H, W) float32, as in `visibility.ViewMaps`.
        votes: (V,) float32 share of the view in the colour at a vertex.
        corrections: (V, 3) float32, added to its colours.
    """

    projection: np.ndarray
    image: np.ndarray
    trust: np.ndarray
    depth: np.ndarray
    votes: np.ndarray
    corrections: np.ndarray


class TexelColors(Protocol):
    """Weighted sums of colours at N texels, which views add to."""

    def begin_round(self, least_votes: float, covered: float) -> None:
        """From now on, views add to texels with less weight than `covered`, where their votes exceed `least_votes`."""

    def add(self, view: VotingView) -> None:
        """Add a view's colours where it is trusted and nothing hides the texel."""

    def finish(self, broad: np.ndarray, broad_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """The mean colours (N, 3) uint8, and the weights (N,) float32 of the views; `broad` (V, 3) float32 weighs `broad_weight`."""


class CpuTexelColors:
    """See `TexelColors`."""

    def __init__(self, corners: np.ndarray, shares: np.ndarray, vertices: np.ndarray, tolerance: float) -> None:
        self._texels, self._tolerance = (corners, shares, vertices), tolerance
        self._color, self._weight = np.zeros((len(corners), 3), np.float32), np.zeros(len(corners), np.float32)
        self._open, self._least_votes = np.ones(len(corners), np.bool_), 0.0

    def begin_round(self, least_votes: float, covered: float) -> None:
        """See `TexelColors`."""
        self._open, self._least_votes = self._weight < covered, least_votes

    def add(self, view: VotingView) -> None:
        """See `TexelColors`."""
        add_view(
            0, 1, *self._texels, view.projection, view.image, view.trust, view.depth, view.votes, view.corrections,
            self._tolerance, self._least_votes, self._open, self._color, self._weight,
        )  # fmt: skip

    def finish(self, broad: np.ndarray, broad_weight: float) -> tuple[np.ndarray, np.ndarray]:
        """See `TexelColors`."""
        mean = np.empty((len(self._weight), 3), np.uint8)
        take_mean(0, 1, *self._texels[:2], broad, np.float32(broad_weight), self._color, self._weight, mean)
        return mean, self._weight


@numba.njit(cache=True)
def add_view(
    first, step, corners, shares, vertices, projection, image, trust, depth, votes, corrections,
    tolerance, least_votes, is_open, color, weight,
):  # fmt: skip
    """What `TexelColors.add` does, at every `step`-th texel from `first` on: all on the processor, a thread's own on CUDA."""
    height, width = depth.shape
    for i in range(first, len(corners), step):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        wa, wb, wc = shares[i, 0], shares[i, 1], shares[i, 2]
        vote = wa * votes[a] + wb * votes[b] + wc * votes[c]
        if not is_open[i] or vote <= least_votes:
            continue
        px = wa * vertices[a, 0] + wb * vertices[b, 0] + wc * vertices[c, 0]
        py = wa * vertices[a, 1] + wb * vertices[b, 1] + wc * vertices[c, 1]
        pz = wa * vertices[a, 2] + wb * vertices[b, 2] + wc * vertices[c, 2]
        along = projection[2, 0] * px + projection[2, 1] * py + projection[2, 2] * pz + projection[2, 3]
        if along <= 0.0:
            continue
        # From the centre of the first pixel.
        x = (projection[0, 0] * px + projection[0, 1] * py + projection[0, 2] * pz + projection[0, 3]) / along - 0.5
        y = (projection[1, 0] * px + projection[1, 1] * py + projection[1, 2] * pz + projection[1, 3]) / along - 0.5
        if not (x >= 0.0 and y >= 0.0 and x < width - 1 and y < height - 1):
            continue
        left, top = int(x), int(y)
        farthest = max(max(depth[top, left], depth[top, left + 1]), max(depth[top + 1, left], depth[top + 1, left + 1]))
        if farthest <= 0.0 or along > farthest + tolerance:
            continue
        right_share, lower_share = np.float32(x - left), np.float32(y - top)
        left_share, upper_share = np.float32(1.0) - right_share, np.float32(1.0) - lower_share
        w00, w01, w10, w11 = upper_share * left_share, upper_share * right_share, lower_share * left_share, lower_share * right_share
        trusted = w00 * trust[top, left] + w01 * trust[top, left + 1] + w10 * trust[top + 1, left] + w11 * trust[top + 1, left + 1]
        strength = vote * trusted
        for k in range(3):
            seen = w00 * image[top, left, k] + w01 * image[top, left + 1, k]
            seen += w10 * image[top + 1, left, k] + w11 * image[top + 1, left + 1, k]
            level = wa * corrections[a, k] + wb * corrections[b, k] + wc * corrections[c, k]
            color[i, k] += strength * (seen + level)
        weight[i] += strength


@numba.njit(cache=True)
def take_mean(first, step, corners, shares, broad, broad_weight, color, weight, mean):
    """What `TexelColors.finish` does, at every `step`-th texel from `first` on."""
    most, half = np.float32(255.0), np.float32(0.5)
    for i in range(first, len(corners), step):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        total = weight[i] + broad_weight
        for k in range(3):
            filled = shares[i, 0] * broad[a, k] + shares[i, 1] * broad[b, k] + shares[i, 2] * broad[c, k]
            level = (color[i, k] + broad_weight * filled) / total * most
            mean[i, k] = np.uint8(min(max(level, np.float32(0.0)), most) + half)


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
