"""The renderer as one differentiable PyTorch operation over the kernels."""

from dataclasses import dataclass
from typing import Any

import torch

from zeroshop_steps.surface.svraster.kernels import layout
from zeroshop_steps.surface.svraster.kernels.render_view import RenderView
from zeroshop_steps.surface.svraster.octree import Octree
from zeroshop_steps.surface.svraster.renderers import CpuRenderer, Renderer

CPU_RENDERER = CpuRenderer()
PARTS: tuple[int | slice, ...] = (slice(0, 3), 3, slice(4, 7), 7, 8, 9, 10)
"""Planes of the image that make up the parts of a `Rendering`, in its order."""


@dataclass(frozen=True)
class Rendering:
    """Images of height x width pixels; all but `median_depth` are sums over the blending weights, not divided by `alpha`.

    Attributes:
        color: (3, H, W) RGB.
        depth: (H, W) weighted depth.
        normal: (3, H, W) weighted normal in the camera frame.
        alpha: (H, W) accumulated opacity.
        median_depth: (H, W) depth at which half of the light is stopped; 0 where less is.
        color_square: (H, W) weighted squared length of the colour.
        away: (H, W) weighted cosine between ray and those normals that face away.
        statistics: holds, after `backward`, each voxel's largest blending weight and priority.
    """

    color: torch.Tensor
    depth: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor
    median_depth: torch.Tensor
    color_square: torch.Tensor
    away: torch.Tensor
    statistics: "VoxelStatistics"


class VoxelStatistics:
    """By-products of the backward pass, for pruning and subdivision; zeros before it.

    Attributes:
        weight: (N,) largest blending weight of each voxel.
        priority: (N,) sum over the pixels of |alpha d loss / d alpha|.
    """

    def __init__(self, count: int) -> None:
        self.weight, self.priority = torch.zeros(2, count)


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, densities: torch.Tensor, sh: torch.Tensor, octree: Octree, degree: int, view: RenderView, statistics: VoxelStatistics,
        renderer: Renderer,
    ) -> tuple[torch.Tensor, ...]:  # fmt: skip
        drawn = renderer.draw(octree, densities, sh, degree, view)
        context.kept = (drawn, view, statistics, renderer)
        context.set_materialize_grads(False)
        planes = drawn.image[:, : view.height_px, : view.width_px]
        return tuple(planes[part] for part in PARTS)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        drawn, view, statistics, renderer = context.kept
        gradient = drawn.image.new_zeros((layout.GRAD_PLANES, *drawn.image.shape[1:]))
        for part, by_part in zip(PARTS, gradients, strict=True):
            if by_part is not None:
                gradient[part][..., : view.height_px, : view.width_px] = by_part
        by_density, by_sh, statistics.weight, statistics.priority = renderer.differentiate(drawn, gradient)
        return by_density, by_sh, None, None, None, None, None


def render(
    octree: Octree, densities: torch.Tensor, sh: torch.Tensor, degree: int, view: RenderView, renderer: Renderer = CPU_RENDERER
) -> Rendering:
    """Render voxels, differentiably.

    Args:
        octree: N leaves with M corners.
        densities: (M,) values at the corners, before activation.
        sh: (N, K, 3) spherical-harmonics coefficients of each leaf; those above `degree` are unused.
        degree: 0 to 3, with (degree + 1)^2 at most K.
        view: camera and tiles.
        renderer: what draws them; its device is that of the tensors.
    """
    statistics = VoxelStatistics(len(octree))
    parts = _Blend.apply(densities, sh, octree, degree, view, statistics, renderer)
    color, depth, normal, alpha, median_depth, color_square, away = parts
    return Rendering(color, depth, normal, alpha, median_depth, color_square, away, statistics)
