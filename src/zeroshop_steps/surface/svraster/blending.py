"""Blending of voxels on a device: one interface over the kernels for the CPU and those for CUDA."""

from typing import Any, NamedTuple, Protocol

import numba
import numpy as np

from zeroshop_steps.runtime.kernel_devices import choose_kernel_device
from zeroshop_steps.surface.svraster import rasterize, rasterize_backward
from zeroshop_steps.surface.svraster.project import GRADIENT_WIDTH
from zeroshop_steps.surface.svraster.tiles import TileOctantLists, TileOctants
from zeroshop_steps.surface.tiling import TILE_PX

VOXELS_A_BLOCK = 16  # of the kernel that sums gradients


class Listed(NamedTuple):
    """The voxels of a view, ready to be drawn.

    Attributes:
        rows, boxes: (N, 28) float32 and (N, 4) int32 of `project.project_forward`.
        camera: (16,) float64, as there.
        tile_octants, lists: the pairs of the view, and the voxels of each.
    """

    rows: np.ndarray
    boxes: np.ndarray
    camera: np.ndarray
    tile_octants: TileOctants
    lists: TileOctantLists

    @property
    def shape_px(self) -> tuple[int, int]:
        """Height and width of the whole tiles."""
        tiles_y, tiles_x, _ = self.tile_octants.index.shape
        return tiles_y * TILE_PX, tiles_x * TILE_PX


class Blending(Protocol):
    """Draws voxels, and carries gradients of the image back to their rows."""

    def draw(self, listed: Listed) -> tuple[np.ndarray, np.ndarray]:
        """The planes of `rasterize`, (12, 16 * tiles_y, 16 * tiles_x) float32, and what `differentiate` wants to know of the drawing."""

    def differentiate(self, listed: Listed, image: np.ndarray, kept: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 16) float32 gradients by the voxels' rows, and (N,) bool, the voxels that may have any.

        Args:
            image, kept: as `draw` returned them.
            gradient: (11, height, width) float32, the loss's derivative by the first eleven planes.
        """


class CpuBlending:
    """Blending on the processor's cores."""

    def draw(self, listed: Listed) -> tuple[np.ndarray, np.ndarray]:
        """See `Blending`; keeps the blocks that each list entry is seen in."""
        rows, boxes, camera, pairs, lists = listed
        image, blocks = np.zeros((rasterize.OUT_PLANES, *listed.shape_px), np.float32), np.empty(len(lists.voxel_of), np.uint16)
        rasterize.blend_forward(
            rows, boxes, camera, pairs.tiles, pairs.octants, lists.pairs, lists.starts, lists.voxel_of, lists.slot_of,
            pairs.index.shape[1], numba.get_num_threads(), image, blocks,
        )  # fmt: skip
        return image, blocks

    def differentiate(self, listed: Listed, image: np.ndarray, kept: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Blending`."""
        rows, _, camera, pairs, lists = listed
        by_row, seen = np.empty((len(rows), GRADIENT_WIDTH), np.float32), np.empty(len(rows), np.bool_)
        rasterize_backward.blend_backward(
            rows, camera, pairs.tiles, pairs.octants, lists.pairs, lists.starts, lists.voxel_of, lists.slot_of, lists.slot_starts,
            pairs.index.shape[1], numba.get_num_threads(), image, kept, gradient, by_row, seen,
        )  # fmt: skip
        return by_row, seen


class CudaBlending:
    """Blending on a CUDA device; rows, lists and images are copied there and back."""

    def __init__(self) -> None:
        from numba import cuda

        from zeroshop_steps.surface.svraster import cuda_kernels

        self._cuda: Any = cuda
        self._kernels = cuda_kernels

    def draw(self, listed: Listed) -> tuple[np.ndarray, np.ndarray]:
        """See `Blending`; keeps nothing."""
        image = self._cuda.to_device(np.zeros((rasterize.OUT_PLANES, *listed.shape_px), np.float32))
        count, tiles_x = len(listed.lists.pairs), listed.tile_octants.index.shape[1]
        if count:
            self._kernels.blend_forward[count, (TILE_PX, TILE_PX)](*self._send(listed), tiles_x, image)
        return np.asarray(image.copy_to_host()), np.zeros(0, np.uint16)

    def differentiate(self, listed: Listed, image: np.ndarray, kept: np.ndarray, gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Blending`."""
        rows, lists, send = listed.rows, listed.lists, self._cuda.to_device
        if not len(lists.pairs):
            return np.zeros((len(rows), GRADIENT_WIDTH), np.float32), np.zeros(len(rows), np.bool_)
        slots, out = (send(np.zeros((count, GRADIENT_WIDTH), np.float32)) for count in (len(lists.voxel_of), len(rows)))
        self._kernels.blend_backward[len(lists.pairs), (TILE_PX, TILE_PX)](
            *self._send(listed), send(lists.slot_of), listed.tile_octants.index.shape[1], send(image), send(gradient), slots
        )
        self._kernels.sum_slots[(-(-len(rows) // VOXELS_A_BLOCK), 1), (VOXELS_A_BLOCK, GRADIENT_WIDTH)](slots, send(lists.slot_starts), out)
        by_row = np.asarray(out.copy_to_host())
        return by_row, np.asarray(by_row.any(axis=1))

    def _send(self, listed: Listed) -> list[Any]:
        rows, boxes, camera, pairs, lists = listed
        arrays = (rows, boxes, camera, pairs.tiles, pairs.octants, pairs.of_pixel, lists.pairs, lists.starts, lists.voxel_of)
        return [self._cuda.to_device(array) for array in arrays]


def make_blending(device: str) -> Blending:
    """The blending of one of cpu, cuda and auto, as `choose_kernel_device` chooses; raises what it raises."""
    return CudaBlending() if choose_kernel_device(device) == "cuda" else CpuBlending()
