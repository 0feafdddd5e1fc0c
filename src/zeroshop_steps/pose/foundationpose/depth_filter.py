"""Measured depth as the networks know it: without lonely values, smoothed, nothing far away."""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

RADIUS_PX = 2  # of the windows, squares of 5 x 5 pixels
STEP_MM = 1.0  # a neighbour that differs by more speaks against a pixel
MOST_AGAINST = 0.8  # share of the neighbours that may do so
LAYER_MM = 10.0  # only values this close to the mean of the window are averaged


def filter_depth(depth_mm: np.ndarray, cut_mm: float) -> np.ndarray:
    """(H, W) depth that is 0 from `cut_mm` on and where too few neighbours agree, else the mean of the neighbourhood."""
    depth = torch.from_numpy(np.where(depth_mm < cut_mm, depth_mm, 0.0).astype(np.float32))
    return _smooth(_drop_lonely(depth)).numpy()


def _windows(depth: Tensor) -> tuple[Tensor, Tensor]:
    """(25, H, W) the values around each pixel, and whether they lie in the image."""
    padded = torch.stack([depth, torch.ones_like(depth)])[:, None]
    values, inside = F.unfold(padded, 2 * RADIUS_PX + 1, padding=RADIUS_PX).unflatten(2, depth.shape)
    return values, inside > 0


def _drop_lonely(depth: Tensor) -> Tensor:
    values, inside = _windows(depth)
    against = inside & ((values <= 0) | ((values - depth).abs() > STEP_MM))
    return torch.where(against.sum(0) > MOST_AGAINST * inside.sum(0), 0.0, depth)


def _smooth(depth: Tensor) -> Tensor:
    values, _ = _windows(depth)
    there = values > 0
    mean = (values * there).sum(0) / there.sum(0).clamp(min=1)
    away = torch.arange(-RADIUS_PX, RADIUS_PX + 1)
    weights = torch.exp(-(away[:, None] ** 2 + away[None] ** 2) / (2 * 2.0**2)).flatten()[:, None, None]
    weights = weights * (there & ((values - mean).abs() < LAYER_MM))
    return (weights * values).sum(0) / weights.sum(0).clamp(min=1e-12)
