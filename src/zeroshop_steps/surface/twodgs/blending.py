"""Blending of splats on a device: one interface over the kernels for the CPU and those for CUDA."""

from typing import Any, Protocol

import numba
import numpy as np

from zeroshop_steps.runtime.kernel_devices import choose_kernel_device
from zeroshop_steps.surface.tiling import TILE_PX
from zeroshop_steps.surface.twodgs import rasterize, rasterize_backward
from zeroshop_steps.surface.twodgs.project import SPLAT_WIDTH
from zeroshop_steps.surface.twodgs.tiles import TileLists

SPLATS_A_BLOCK = 16  # of the kernel that sums gradients


class Blending(Protocol):
    """Draws splats, and carries gradients of the image back to them."""

    def draw(self, splats: np.ndarray, lists: TileLists, shape: tuple[int, int], distortion: bool, depth_map: np.ndarray) -> np.ndarray:
        """(12, 16 * tiles_y, 16 * tiles_x) float32, the planes of `rasterize`.

        Args:
            splats: (N, 16) float32 rows of `project.project_forward`.
            lists: those that each tile shows; their blocks may be thinned.
            shape: (tiles_y, tiles_x).
            distortion: whether to fill the planes of the depth distortion.
            depth_map: (2,) float32, k1 and k2 of its mapped depth k1 - k2 / z.
        """

    def differentiate(
        self, splats: np.ndarray, lists: TileLists, distortion: bool, depth_map: np.ndarray, image: np.ndarray, gradient: np.ndarray
    ) -> np.ndarray:
        """(N, 16) float32 gradients by the splat rows.

        Args:
            image: as `draw` returned it, with the same lists.
            gradient: (10, height, width) float32, the loss's derivative by the first ten planes.
            The others are those of `draw`.
        """


class CpuBlending:
    """Blending on the processor's cores."""

    def draw(self, splats: np.ndarray, lists: TileLists, shape: tuple[int, int], distortion: bool, depth_map: np.ndarray) -> np.ndarray:
        """See `Blending`."""
        image = np.zeros((rasterize.OUT_PLANES, shape[0] * TILE_PX, shape[1] * TILE_PX), np.float32)
        rasterize.blend_forward(
            splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.blocks,
            shape[1], distortion, *depth_map, numba.get_num_threads(), image,
        )  # fmt: skip
        return image

    def differentiate(
        self, splats: np.ndarray, lists: TileLists, distortion: bool, depth_map: np.ndarray, image: np.ndarray, gradient: np.ndarray
    ) -> np.ndarray:
        """See `Blending`."""
        out = np.empty_like(splats)
        rasterize_backward.blend_backward(
            splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.slot_starts, lists.blocks,
            image.shape[2] // TILE_PX, distortion, *depth_map, numba.get_num_threads(), image, gradient, out,
        )  # fmt: skip
        return out


class CudaBlending:
    """Blending on a CUDA device; splats, lists and images are copied there and back."""

    def __init__(self) -> None:
        from numba import cuda

        from zeroshop_steps.surface.twodgs import cuda_kernels

        self._cuda: Any = cuda
        self._kernels = cuda_kernels

    def draw(self, splats: np.ndarray, lists: TileLists, shape: tuple[int, int], distortion: bool, depth_map: np.ndarray) -> np.ndarray:
        """See `Blending`."""
        image = self._cuda.to_device(np.zeros((rasterize.OUT_PLANES, shape[0] * TILE_PX, shape[1] * TILE_PX), np.float32))
        if len(lists.tiles):
            self._kernels.blend_forward[len(lists.tiles), (TILE_PX, TILE_PX)](
                *self._send(splats, lists), shape[1], distortion, *depth_map, image
            )
        return np.asarray(image.copy_to_host())

    def differentiate(
        self, splats: np.ndarray, lists: TileLists, distortion: bool, depth_map: np.ndarray, image: np.ndarray, gradient: np.ndarray
    ) -> np.ndarray:
        """See `Blending`."""
        if not len(lists.tiles):
            return np.zeros_like(splats)
        send = self._cuda.to_device
        slots, out = send(np.zeros((len(lists.blocks), SPLAT_WIDTH), np.float32)), send(np.zeros_like(splats))
        self._kernels.blend_backward[len(lists.tiles), (TILE_PX, TILE_PX)](
            *self._send(splats, lists), image.shape[2] // TILE_PX, distortion, *depth_map, send(image), send(gradient), slots
        )
        self._kernels.sum_slots[(-(-len(splats) // SPLATS_A_BLOCK), 1), (SPLATS_A_BLOCK, SPLAT_WIDTH)](slots, send(lists.slot_starts), out)
        return np.asarray(out.copy_to_host())

    def _send(self, splats: np.ndarray, lists: TileLists) -> list[Any]:
        arrays = (splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.blocks)
        return [self._cuda.to_device(array) for array in arrays]


def make_blending(device: str) -> Blending:
    """The blending of one of cpu, cuda and auto, as `choose_kernel_device` chooses; raises what it raises."""
    return CudaBlending() if choose_kernel_device(device) == "cuda" else CpuBlending()
