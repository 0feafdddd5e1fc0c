"""Structural similarity in a few lines of differentiable PyTorch: what `dssim` must agree with."""

import torch

from zeroshop_steps.surface.training.ssim import blur, gaussian_window, similarity_of


def ssim_map(image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Structural similarity of two (C, H, W) images in [0, 1] as a (C, H, W) map."""
    blurred = blur(torch.cat([image, image * image, image * target, target, target * target]), gaussian_window())
    return similarity_of(*blurred.split(len(image)))
