"""The steps of a rendering on a device: one interface over the kernels for the CPU and those for CUDA."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numba
import numpy as np
import torch

from zeroshop_steps.runtime.compute.device_arrays import THREADS, blocks_of_threads, choose_kernels, tensor_device, to_kernel
from zeroshop_steps.surface.rendering.sorted_lists import invert_order, sort_into_groups
from zeroshop_steps.surface.rendering.tiling import TILE_PX
from zeroshop_steps.surface.svraster.kernels import layout, project, rasterize, rasterize_backward, tiles
from zeroshop_steps.surface.svraster.kernels.render_view import RenderView
from zeroshop_steps.surface.svraster.octree import Octree

VOXELS_A_BLOCK = THREADS // layout.GRADIENT_WIDTH
"""Of the CUDA kernel that sums gradients."""


@dataclass(frozen=True)
class Drawn:
    """A drawn view.

    Attributes:
        image: (12, 16 * tiles_y, 16 * tiles_x) float32, the planes of `rasterize`.
        kept: what the renderer that drew it needs to differentiate it.
    """

    image: torch.Tensor
    kept: Any


class Gradients(NamedTuple):
    """Gradients by densities (M,) and sh (N, K, 3), and, of each voxel, (N,), the largest blending weight and the priority."""

    densities: torch.Tensor
    sh: torch.Tensor
    weight: torch.Tensor
    priority: torch.Tensor


class Renderer(Protocol):
    """Draws voxels, and carries gradients of the image back to their parameters.

    Attributes:
        device: where its tensors lie.
    """

    device: torch.device

    def draw(self, octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, view: RenderView) -> Drawn:
        """Draw a view; the arguments are those of `render.render`."""

    def differentiate(self, drawn: Drawn, gradient: torch.Tensor) -> Gradients:
        """Gradients by the parameters.

        Args:
            gradient: (11, 16 * tiles_y, 16 * tiles_x) float32, the loss's derivative by the first eleven planes.
        """


class CpuRenderer:
    """Rendering on the processor's cores."""

    device = torch.device("cpu")

    def draw(self, octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, view: RenderView) -> Drawn:
        """See `Renderer`."""
        arrays = densities.detach().contiguous().numpy(), sh.detach().contiguous().numpy()
        workers, (tiles_y, tiles_x) = numba.get_num_threads(), view.tile_shape
        rows, boxes = np.empty((len(octree), layout.ROW_WIDTH), np.float32), np.empty((len(octree), 4), np.int32)
        project.project_forward(
            octree.centres, octree.sizes, octree.corners, *arrays, degree,
            view.camera, view.width_px, view.height_px, view.near, workers, rows, boxes,
        )  # fmt: skip
        lists = tiles.list_voxels_by_tile(view.tile_octants, octree.orders, boxes)
        image = np.zeros((layout.OUT_PLANES, tiles_y * TILE_PX, tiles_x * TILE_PX), np.float32)
        blocks = np.empty(len(lists.voxel_of), np.uint16)
        rasterize.blend_forward(
            rows, boxes, view.camera, view.tile_octants.tiles, view.tile_octants.octants, lists.pairs, lists.starts, lists.voxel_of,
            lists.slot_of, tiles_x, workers, image, blocks,
        )  # fmt: skip
        return Drawn(torch.from_numpy(image), (arrays, octree, degree, view, blocks, rows, boxes, lists))

    def differentiate(self, drawn: Drawn, gradient: torch.Tensor) -> Gradients:
        """See `Renderer`."""
        (densities, sh), octree, degree, view, blocks, rows, _, lists = drawn.kept
        workers = numba.get_num_threads()
        by_row, seen = np.empty((len(octree), layout.GRADIENT_WIDTH), np.float32), np.empty(len(octree), np.bool_)
        rasterize_backward.blend_backward(
            rows, view.camera, view.tile_octants.tiles, view.tile_octants.octants, lists.pairs, lists.starts, lists.voxel_of, lists.slot_of,
            lists.slot_starts, view.tile_shape[1], workers, drawn.image.numpy(), blocks, gradient.numpy(), by_row, seen,
        )  # fmt: skip
        by_corner, by_sh = np.zeros((len(octree), 8), np.float32), np.zeros_like(sh)
        project.project_backward(octree.centres, degree, view.camera, workers, rows, seen, by_row, by_corner, by_sh)
        by_density = np.empty_like(densities)
        project.gather_corners(*octree.corner_uses, by_corner.ravel(), by_density)
        outputs = by_density, by_sh, by_row[:, layout.G_WEIGHT], by_row[:, layout.G_PRIORITY]
        return Gradients(*map(torch.from_numpy, outputs))


class DeviceOctree(NamedTuple):
    """An octree as tensors of a device, as `Octree` has it; `ranks` (8, N) int64 are the places of the leaves in its orders."""

    centres: torch.Tensor
    sizes: torch.Tensor
    corners: torch.Tensor
    use_starts: torch.Tensor
    uses: torch.Tensor
    ranks: torch.Tensor


class CudaRenderer:
    """Rendering on a CUDA device. Parameters, rows, lists, images and gradients are tensors there; one count comes to the host."""

    def __init__(self) -> None:
        from zeroshop_steps.surface.svraster.kernels import cuda_kernels, cuda_projection

        self.device = tensor_device("cuda")
        self._kernels, self._projection = cuda_kernels, cuda_projection
        self._octree: tuple[Octree, DeviceOctree] | None = None

    def draw(self, octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, view: RenderView) -> Drawn:
        """See `Renderer`."""
        densities, sh = densities.detach().contiguous(), sh.detach().contiguous()
        leaves, on, count = self._send(octree), view.on(self.device), len(octree)
        (tiles_y, tiles_x), pairs = view.tile_shape, len(view.tile_octants.tiles)
        rows, boxes = self._zeros(count, layout.ROW_WIDTH), self._zeros(count, 4, dtype=torch.int32)
        per_voxel = self._zeros(count, dtype=torch.int32)
        self._projection.project[blocks_of_threads(count), THREADS](
            *map(to_kernel, (*leaves[:3], densities, sh)), degree, to_kernel(on.camera), view.width_px, view.height_px, view.near,
            to_kernel(on.pair_index), count, *map(to_kernel, (rows, boxes, per_voxel)),
        )  # fmt: skip
        slot_starts = torch.nn.functional.pad(per_voxel.cumsum(0, dtype=torch.int32), (1, 0))
        pair_of, voxel_of = self._zeros(2, int(slot_starts[-1]), dtype=torch.int32)
        self._projection.list_pairs[blocks_of_threads(count), THREADS](
            *map(to_kernel, (boxes, on.pair_index, slot_starts)), count, to_kernel(pair_of), to_kernel(voxel_of)
        )
        ranks = leaves.ranks[on.octants[pair_of.long()], voxel_of.long()]
        starts, order = sort_into_groups(pair_of.long(), ranks, max(count, 1), pairs)
        drawing = (rows, boxes, on.camera, on.tiles, on.octants, on.of_pixel, starts, voxel_of[order])
        image = self._zeros(layout.OUT_PLANES, tiles_y * TILE_PX, tiles_x * TILE_PX)
        if pairs:
            self._kernels.blend_forward[pairs, (TILE_PX, TILE_PX)](*map(to_kernel, drawing), tiles_x, to_kernel(image))
        return Drawn(image, (densities, sh, octree, degree, view, drawing, order.int(), slot_starts))

    def differentiate(self, drawn: Drawn, gradient: torch.Tensor) -> Gradients:
        """See `Renderer`."""
        densities, sh, octree, degree, view, drawing, slot_of, slot_starts = drawn.kept
        leaves, count, pairs = self._send(octree), len(octree), len(view.tile_octants.tiles)
        rows, boxes, camera = drawing[:3]
        slots, by_row = self._zeros(len(slot_of), layout.GRADIENT_WIDTH), self._zeros(count, layout.GRADIENT_WIDTH)
        if pairs:
            self._kernels.blend_backward[pairs, (TILE_PX, TILE_PX)](
                *map(to_kernel, (*drawing, slot_of)), view.tile_shape[1], *map(to_kernel, (drawn.image, gradient, slots))
            )
        self._projection.sum_slots[(-(-count // VOXELS_A_BLOCK) or 1, 1), (VOXELS_A_BLOCK, layout.GRADIENT_WIDTH)](
            to_kernel(slots), to_kernel(slot_starts), count, to_kernel(by_row)
        )
        by_corner, by_sh, by_density = self._zeros(count, 8), torch.zeros_like(sh), torch.zeros_like(densities)
        self._projection.differentiate[blocks_of_threads(count), THREADS](
            to_kernel(leaves.centres), degree, to_kernel(camera), count, *map(to_kernel, (rows, boxes, by_row, by_corner, by_sh))
        )
        self._projection.gather_corners[blocks_of_threads(len(densities)), THREADS](
            *map(to_kernel, (leaves.use_starts, leaves.uses, by_corner.view(-1))), len(densities), to_kernel(by_density)
        )
        return Gradients(by_density, by_sh, by_row[:, layout.G_WEIGHT], by_row[:, layout.G_PRIORITY])

    def _send(self, octree: Octree) -> DeviceOctree:
        """The tree on the device, where it is kept until another one is drawn: training changes it a few times only."""
        if self._octree is None or self._octree[0] is not octree:
            arrays = (octree.centres, octree.sizes, octree.corners, *octree.corner_uses, octree.orders.astype(np.int64))
            centres, sizes, corners, starts, uses, orders = (torch.from_numpy(array).to(self.device) for array in arrays)
            self._octree = octree, DeviceOctree(centres, sizes, corners, starts, uses, invert_order(orders))
        return self._octree[1]

    def _zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        return torch.zeros(shape, dtype=dtype, device=self.device)


def make_renderer(device: str) -> Renderer:
    """The renderer of one of cpu, cuda and auto, as `choose_kernels` chooses; raises what it raises."""
    return CudaRenderer() if choose_kernels(device) == "cuda" else CpuRenderer()
