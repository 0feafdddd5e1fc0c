"""Losses that the optimizers share, on cropped images of (channels, height, width)."""

from typing import Protocol

import torch
import torch.nn.functional as F

from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.ssim import dssim

SOLID_ALPHA = 0.5
"""Accumulated opacity from which a pixel shows a surface, which has depth and normal."""


class RenderedImages(Protocol):
    """The part of a rendering that every optimizer has: sums over the blending weights, not divided by the opacity.

    Attributes:
        color: (3, H, W) RGB. depth: (H, W). normal: (3, H, W) in the camera frame. alpha: (H, W) accumulated opacity.
    """

    @property
    def color(self) -> torch.Tensor: ...

    @property
    def depth(self) -> torch.Tensor: ...

    @property
    def normal(self) -> torch.Tensor: ...

    @property
    def alpha(self) -> torch.Tensor: ...


def image_losses(rendering: RenderedImages, view: TrainingView, lambda_dssim: float, lambda_mask: float) -> dict[str, torch.Tensor]:
    """L1 and D-SSIM of the colour (Kerbl et al. 2023), and L1 of the opacity against the mask: means over the active pixels,
    weighted by how sure the mask is of them."""
    counted = view.counted
    pixels = counted.sum()
    return {
        "l1": (1 - lambda_dssim) * ((rendering.color - view.color).abs().sum(0) * counted).sum() / (3 * pixels),
        "dssim": lambda_dssim * dssim(rendering.color, view.color, counted.float()) / (3 * pixels),
        "mask": lambda_mask * ((rendering.alpha - view.mask).abs() * counted).sum() / pixels,
    }


def depth_loss(
    rendering: RenderedImages, pixels: torch.Tensor, depths: torch.Tensor, weights: torch.Tensor, total: torch.Tensor
) -> torch.Tensor:
    """Weighted sum of the absolute differences between expected and known depths, divided by `total`.

    With the number of active pixels, a single confirmed depth weighs the same however many there are. Where a surface has little
    texture, confirmed depths are more exact than what colour alone finds; their weight in the loss is therefore high.

    Args:
        pixels, depths, weights: (K,) flat pixel indices, the confirmed depths there, and how much each counts.
        total: what the sum is divided by, as a tensor.
    """
    if len(pixels) == 0:
        return rendering.depth.sum() * 0.0
    depth = rendering.depth.reshape(-1)[pixels] / rendering.alpha.reshape(-1)[pixels].clamp(min=1e-2)
    return ((depth - depths).abs() * weights).sum() / total


def normal_mismatch(rendering: RenderedImages, surface_normals: torch.Tensor, counted: torch.Tensor) -> torch.Tensor:
    """How far the blended normals turn away from those of a surface (Huang et al. 2024, eq. 14), summed over some pixels.

    Args:
        surface_normals: (3, H, W) in the camera frame.
        counted: (H, W) bool, the pixels that count.
    """
    mismatch = rendering.alpha.detach() - (rendering.normal * surface_normals).sum(0)
    return (mismatch * counted).sum()


def normals_from_depth(depth: torch.Tensor, fx: float, fy: float, cx: float, cy: float) -> torch.Tensor:
    """Normals of the surface that a depth map describes, by central differences of its points (Huang et al. 2024, eq. 15).

    Args:
        depth: (H, W) depth along the optical axis.
        fx, fy, cx, cy: pinhole intrinsics in pixels; pixel centres lie at half integers.

    Returns:
        (3, H, W) unit normals in the camera frame, facing the camera; zero on the outermost pixels.
    """
    height, width = depth.shape
    x = (torch.arange(width, dtype=depth.dtype, device=depth.device) + 0.5 - cx) / fx
    y = (torch.arange(height, dtype=depth.dtype, device=depth.device) + 0.5 - cy) / fy
    points = torch.stack([x[None, :] * depth, y[:, None] * depth, depth])
    across = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    down = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    normals = torch.linalg.cross(down, across, dim=0)
    # Five times as fast on the CPU as torch's own norm over three planes.
    lengths = (normals * normals).sum(0).clamp(min=1e-24).sqrt()
    return F.pad(normals / lengths, (1, 1, 1, 1))


def has_normal(depth: torch.Tensor) -> torch.Tensor:
    """(H, W) bool: the pixels whose result of `normals_from_depth` is a normal of the surface.

    The depth map, (H, W), is 0 beside the surface. At a contour one of the four neighbours has no depth: the difference is
    then taken to the camera's centre, and the normal points inwards.
    """
    known = depth > 0
    return F.pad(known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1], (1, 1, 1, 1))
