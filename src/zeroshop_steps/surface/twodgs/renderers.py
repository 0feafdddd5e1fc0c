"""The steps of a rendering on a device: one interface over the kernels for the CPU and those for CUDA."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numba
import numpy as np
import torch

from zeroshop_steps.runtime.compute.device_arrays import THREADS, blocks_of_threads, choose_kernels, tensor_device, to_kernel
from zeroshop_steps.surface.rendering.sorted_lists import invert_order, sort_into_groups
from zeroshop_steps.surface.rendering.tiling import TILE_PX
from zeroshop_steps.surface.twodgs.kernels import layout, project, rasterize, rasterize_backward, tiles
from zeroshop_steps.surface.twodgs.kernels.render_view import RenderView

SPLATS_A_BLOCK = THREADS // layout.SPLAT_WIDTH
"""Of the CUDA kernel that sums gradients."""


@dataclass(frozen=True)
class Drawn:
    """A drawn view.

    Attributes:
        image: (12, 16 * tiles_y, 16 * tiles_x) float32, the planes of `rasterize`.
        visible: (N,) bool, the surfels that were drawn.
        kept: what the renderer that drew it needs to differentiate it.
    """

    image: torch.Tensor
    visible: torch.Tensor
    kept: Any


class Renderer(Protocol):
    """Draws surfels, and carries gradients of the image back to their parameters.

    Attributes:
        device: where its tensors lie.
    """

    device: torch.device

    def draw(self, parameters: Sequence[torch.Tensor], degree: int, view: RenderView, distortion: bool) -> Drawn:
        """Draw a view.

        Args:
            parameters: positions, log scales, quaternions, opacity logits and spherical harmonics, as `render` takes them.
            degree, distortion: as `render` takes them.
        """

    def differentiate(self, drawn: Drawn, gradient: torch.Tensor, distortion: bool) -> tuple[list[torch.Tensor], torch.Tensor]:
        """Gradients by the five parameters, and (N,) the length of the gradient by each projected centre, in loss per pixel.

        Args:
            gradient: (10, 16 * tiles_y, 16 * tiles_x) float32, the loss's derivative by the first ten planes.
            distortion: whether the distortion's plane has a gradient.
        """


class CpuRenderer:
    """Rendering on the processor's cores."""

    device = torch.device("cpu")

    def draw(self, parameters: Sequence[torch.Tensor], degree: int, view: RenderView, distortion: bool = False) -> Drawn:
        """See `Renderer`."""
        arrays = [tensor.detach().contiguous().numpy() for tensor in parameters]
        count, workers = len(arrays[0]), numba.get_num_threads()
        splats, boxes = np.zeros((count, layout.SPLAT_WIDTH), np.float32), np.empty((count, 4), np.int32)
        outlines = np.empty((count, layout.OUTLINE_WIDTH), np.float32)
        project.project_forward(
            *arrays, degree, view.camera, view.width_px, view.height_px, view.near, workers, splats, outlines, boxes
        )  # fmt: skip
        lists = tiles.list_splats_by_tile(splats, outlines, boxes, view.tile_active, workers)
        tiles_y, tiles_x = view.tile_active.shape
        image = np.zeros((layout.OUT_PLANES, tiles_y * TILE_PX, tiles_x * TILE_PX), np.float32)
        rasterize.blend_forward(
            splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.blocks,
            tiles_x, distortion, *np.array(view.depth_map, np.float32), workers, image,
        )  # fmt: skip
        visible = np.zeros(count, bool)
        visible[lists.splat_of] = True
        return Drawn(torch.from_numpy(image), torch.from_numpy(visible), (arrays, degree, view, splats, boxes, lists))

    def differentiate(self, drawn: Drawn, gradient: torch.Tensor, distortion: bool) -> tuple[list[torch.Tensor], torch.Tensor]:
        """See `Renderer`."""
        arrays, degree, view, splats, boxes, lists = drawn.kept
        by_splat, workers = np.empty_like(splats), numba.get_num_threads()
        rasterize_backward.blend_backward(
            splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.slot_starts, lists.blocks, view.tile_active.shape[1],
            distortion, *np.array(view.depth_map, np.float32), workers, drawn.image.numpy(), gradient.numpy(), by_splat,
        )  # fmt: skip
        outputs = [np.zeros_like(array) for array in arrays]
        positions, log_scales, quaternions, _, sh = arrays
        project.project_backward(
            positions, log_scales, quaternions, sh, degree, view.camera, workers, splats, boxes, by_splat, *outputs
        )  # fmt: skip
        lengths = np.hypot(by_splat[:, layout.CX], by_splat[:, layout.CY])
        return [torch.from_numpy(output) for output in outputs], torch.from_numpy(lengths)


class CudaRenderer:
    """Rendering on a CUDA device. Parameters, splats, lists, images and gradients are tensors there; two counts come to the host."""

    def __init__(self) -> None:
        from zeroshop_steps.surface.twodgs.kernels import cuda_kernels, cuda_projection

        self.device = tensor_device("cuda")
        self._kernels, self._projection = cuda_kernels, cuda_projection

    def draw(self, parameters: Sequence[torch.Tensor], degree: int, view: RenderView, distortion: bool = False) -> Drawn:
        """See `Renderer`."""
        tensors = [tensor.detach().contiguous() for tensor in parameters]
        count, (camera, tile_active) = len(tensors[0]), view.on(self.device)
        tiles_y, tiles_x = view.tile_active.shape
        splats, outlines = self._zeros(count, layout.SPLAT_WIDTH), self._zeros(count, layout.OUTLINE_WIDTH)
        boxes, per_splat = self._zeros(count, 4, dtype=torch.int32), self._zeros(count, dtype=torch.int32)
        self._projection.project[blocks_of_threads(count), THREADS](
            *map(to_kernel, tensors), degree, to_kernel(camera), view.width_px, view.height_px, view.near, count,
            *map(to_kernel, (splats, outlines, boxes, per_splat)),
        )  # fmt: skip
        slot_starts = torch.nn.functional.pad(per_splat.cumsum(0, dtype=torch.int32), (1, 0))
        blocks, tile_of, splat_of = self._zeros(3, int(slot_starts[-1]), dtype=torch.int32)
        self._projection.mark_blocks[blocks_of_threads(count), THREADS](
            *map(to_kernel, (splats, outlines, boxes, tile_active, slot_starts)),
            tiles_x,
            count,
            *map(to_kernel, (blocks, tile_of, splat_of)),
        )
        starts, splats_listed, slots_listed = list_slots_by_tile(splats[:, layout.ZC], blocks, tile_of, splat_of, tiles_y * tiles_x)
        lists = (starts, splats_listed, slots_listed, blocks)
        image = self._zeros(layout.OUT_PLANES, tiles_y * TILE_PX, tiles_x * TILE_PX)
        self._kernels.blend_forward[tiles_y * tiles_x, (TILE_PX, TILE_PX)](
            to_kernel(splats), *map(to_kernel, lists), tiles_x, distortion, *np.array(view.depth_map, np.float32), to_kernel(image)
        )
        visible = self._zeros(count, dtype=torch.bool)
        visible[splats_listed.long()] = True
        return Drawn(image, visible, (tensors, degree, view, splats, boxes, lists, slot_starts))

    def differentiate(self, drawn: Drawn, gradient: torch.Tensor, distortion: bool) -> tuple[list[torch.Tensor], torch.Tensor]:
        """See `Renderer`."""
        tensors, degree, view, splats, boxes, lists, slot_starts = drawn.kept
        count, (camera, _), (tiles_y, tiles_x) = len(splats), view.on(self.device), view.tile_active.shape
        slots, by_splat = self._zeros(len(lists[3]), layout.SPLAT_WIDTH), torch.zeros_like(splats)
        self._kernels.blend_backward[tiles_y * tiles_x, (TILE_PX, TILE_PX)](
            to_kernel(splats), *map(to_kernel, lists), tiles_x, distortion, *np.array(view.depth_map, np.float32),
            *map(to_kernel, (drawn.image, gradient, slots)),
        )  # fmt: skip
        self._projection.sum_slots[(-(-count // SPLATS_A_BLOCK) or 1, 1), (SPLATS_A_BLOCK, layout.SPLAT_WIDTH)](
            to_kernel(slots), to_kernel(slot_starts), count, to_kernel(by_splat)
        )
        outputs = [torch.zeros_like(tensor) for tensor in tensors]
        positions, log_scales, quaternions, _, sh = map(to_kernel, tensors)
        self._projection.differentiate[blocks_of_threads(count), THREADS](
            positions, log_scales, quaternions, sh, degree, to_kernel(camera), count,
            *map(to_kernel, (splats, boxes, by_splat, *outputs)),
        )  # fmt: skip
        return outputs, torch.hypot(by_splat[:, layout.CX], by_splat[:, layout.CY])

    def _zeros(self, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        return torch.zeros(shape, dtype=dtype, device=self.device)


def make_renderer(device: str) -> Renderer:
    """The renderer of one of cpu, cuda and auto, as `choose_kernels` chooses; raises what it raises."""
    return CudaRenderer() if choose_kernels(device) == "cuda" else CpuRenderer()


def list_slots_by_tile(
    depths: torch.Tensor, blocks: torch.Tensor, tile_of: torch.Tensor, splat_of: torch.Tensor, tiles: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Sort the slots that show something into tiles; those of one tile by depth, and equal depths by number.

    Args:
        depths: (N,) float32 of the splats' centres.
        blocks, tile_of, splat_of: (S,) int32 of each slot: the blocks that are seen, none in tiles that are not drawn, its tile and splat.
        tiles: their number.

    Returns:
        starts (tiles + 1,) int64, splat_of and slot_of (I,) int32, as `tiles.TileLists` has them.
    """
    rank = invert_order(torch.sort(depths, stable=True).indices)
    shown = torch.nonzero(blocks).flatten()
    starts, order = sort_into_groups(tile_of[shown].long(), rank[splat_of[shown].long()], max(len(depths), 1), tiles)
    slot_of = shown[order]
    return starts, splat_of[slot_of], slot_of.int()
