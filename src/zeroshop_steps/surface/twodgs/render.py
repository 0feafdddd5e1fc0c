"""The renderer as one differentiable PyTorch operation over the kernels."""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch

from zeroshop_steps.surface.twodgs.kernels import layout, surface_depth
from zeroshop_steps.surface.twodgs.kernels.render_view import RenderView
from zeroshop_steps.surface.twodgs.renderers import CpuRenderer, Renderer

CPU_RENDERER = CpuRenderer()
PARTS: tuple[int | slice, ...] = (slice(0, 3), 3, slice(4, 7), 7, 8, 9)
"""Planes of the image that make up the parts of a `Rendering`, in its order."""


@dataclass(frozen=True)
class Rendering:
    """Images of height x width pixels; `color`, `depth` and `normal` are sums over the blending weights, not divided by `alpha`.

    Attributes:
        color: (3, H, W) RGB.
        depth: (H, W) weighted depth.
        normal: (3, H, W) weighted normal in the camera frame, facing the camera.
        alpha: (H, W) accumulated opacity.
        median_depth: (H, W) depth at which half of the light is stopped; 0 where nothing is hit.
        distortion: (H, W) depth distortion (Huang et al. 2024, eq. 13, in mapped depth), where asked for.
        statistics: which surfels were drawn and, after `backward`, their screen-space gradients.
    """

    color: torch.Tensor
    depth: torch.Tensor
    normal: torch.Tensor
    alpha: torch.Tensor
    median_depth: torch.Tensor
    distortion: torch.Tensor
    statistics: "SurfelStatistics"


class SurfelStatistics:
    """By-products of a rendering, for densification.

    Attributes:
        visible: (N,) bool, the surfels that were drawn.
        centre_gradient: (N,) length of the gradient by a surfel's projected centre, in loss per pixel; zeros before `backward`.
    """

    def __init__(self, count: int) -> None:
        self.visible, self.centre_gradient = torch.zeros(count, dtype=torch.bool), torch.zeros(count)


class _Splat(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, positions: torch.Tensor, log_scales: torch.Tensor, quaternions: torch.Tensor, opacity_logits: torch.Tensor,
        sh: torch.Tensor, degree: int, view: RenderView, distortion: bool, statistics: SurfelStatistics, renderer: Renderer,
    ) -> tuple[torch.Tensor, ...]:  # fmt: skip
        drawn = renderer.draw((positions, log_scales, quaternions, opacity_logits, sh), degree, view, distortion)
        statistics.visible = drawn.visible
        context.kept = (drawn, view, distortion, statistics, renderer)
        context.set_materialize_grads(False)
        planes = drawn.image[:, : view.height_px, : view.width_px]
        return tuple(planes[part] for part in PARTS)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        drawn, view, distortion, statistics, renderer = context.kept
        gradient = drawn.image.new_zeros((layout.GRAD_PLANES, *drawn.image.shape[1:]))
        for part, by_part in zip(PARTS, gradients, strict=True):
            if by_part is not None:
                gradient[part][..., : view.height_px, : view.width_px] = by_part
        distortion = distortion and gradients[-1] is not None
        outputs, statistics.centre_gradient = renderer.differentiate(drawn, gradient, distortion)
        return *outputs, None, None, None, None, None


def render_surface_depth(
    positions: torch.Tensor,
    log_scales: torch.Tensor,
    quaternions: torch.Tensor,
    opacity_logits: torch.Tensor,
    view: RenderView,
    reach: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the surface, (H, W) float32, 0 where nothing is hit, and the accumulated opacity, (H, W); not differentiable.

    Args:
        reach: surfels within this of a pixel's median depth are averaged.
        The other arguments are those of `render`.
    """
    tensors = (positions, log_scales, quaternions, opacity_logits, torch.zeros(len(positions), 16, 3))
    drawn = CPU_RENDERER.draw(tensors, 0, view)
    image, (*_, splats, _, lists) = drawn.image.numpy(), drawn.kept
    depth, median = np.zeros(image.shape[1:], np.float32), image[layout.OUT_MEDIAN]
    tiles_x = view.tile_active.shape[1]
    surface_depth.mean_near_median(
        splats, lists.tiles, lists.starts, lists.splat_of, lists.slot_of, lists.blocks, tiles_x, numba.get_num_threads(),
        median, np.float32(reach), depth,
    )  # fmt: skip
    crop = (slice(view.height_px), slice(view.width_px))
    return depth[crop], image[layout.OUT_ALPHA][crop]


def render(
    positions: torch.Tensor, log_scales: torch.Tensor, quaternions: torch.Tensor, opacity_logits: torch.Tensor, sh: torch.Tensor,
    degree: int, view: RenderView, distortion: bool = False, renderer: Renderer = CPU_RENDERER,
) -> Rendering:  # fmt: skip
    """Render surfels, differentiably.

    Args:
        positions: (N, 3) centres in the world.
        log_scales: (N, 2) natural logarithm of the two standard deviations.
        quaternions: (N, 4) rotation, w first, of any length; its columns are t_u, t_v and the normal.
        opacity_logits: (N,).
        sh: (N, 16, 3) spherical-harmonics coefficients; those above `degree` are unused.
        degree: 0 to 3.
        view: camera and tiles.
        distortion: whether the loss needs the depth distortion, which is zero otherwise.
        renderer: what draws them; its device is that of the tensors.
    """
    statistics = SurfelStatistics(len(positions))
    color, depth, normal, alpha, median_depth, depth_distortion = _Splat.apply(
        positions, log_scales, quaternions, opacity_logits, sh, degree, view, distortion, statistics, renderer
    )
    return Rendering(color, depth, normal, alpha, median_depth, depth_distortion, statistics)
