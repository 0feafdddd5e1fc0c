"""Adaptive density control: add surfels where the images ask for more, drop those that do nothing (Kerbl et al. 2023, sec. 5.2)."""

import numpy as np
import torch

from zeroshop_steps.surface.training.optimizer import ResizableAdam
from zeroshop_steps.surface.twodgs.surfels import Surfels, rotation_matrices

SPLIT_SHRINKAGE = 1.6
"""The two halves of a split surfel are smaller by this factor (Kerbl et al. 2023)."""


class GradientMeter:
    """Mean length of each surfel's screen-space gradient over the views that drew it since the last densification."""

    def __init__(self, count: int, device: torch.device | None = None) -> None:
        self.total, self.views = torch.zeros(2, count, dtype=torch.float64, device=device)

    def add(self, gradient: torch.Tensor, visible: torch.Tensor) -> None:
        """Count one view: (N,) lengths of gradients, and (N,) bool, the surfels that were drawn."""
        self.total += gradient * visible
        self.views += visible

    def mean(self) -> torch.Tensor:
        """(N,) means, zero for surfels that no view drew."""
        return self.total / self.views.clamp(min=1)


def densify_and_prune(
    surfels: Surfels, optimizer: ResizableAdam, meter: GradientMeter, threshold: float, large: float, opacity_min: float,
    excluded: torch.Tensor, count_max: int, generator: torch.Generator,
) -> None:  # fmt: skip
    """Clone small surfels and split large ones where the mean gradient exceeds the threshold; drop faint and excluded ones.

    Args:
        threshold: gradient, in loss per pixel of shift summed over the image's pixels.
        large: scale, in normalized units, from which a surfel is split into two rather than cloned.
        opacity_min: surfels fainter than this are dropped.
        excluded: (N,) bool, surfels to drop for other reasons, such as lying in free space.
        count_max: no more surfels than this; where too many exceed the threshold, those with the largest gradients win.
        generator: of the random places of the halves.
    """
    with torch.no_grad():
        scales = surfels.log_scales.exp()
        widest = scales.max(dim=1).values
        faint = torch.sigmoid(surfels.opacity_logits) < opacity_min
        gone = faint | excluded
        gradient = meter.mean()
        gradient[gone] = 0.0
        room = max(count_max - int((~gone).sum()), 0)
        wanted = gradient > threshold
        if int(wanted.sum()) > room:
            keep_best = torch.argsort(gradient, descending=True, stable=True)[:room]
            wanted = torch.zeros_like(wanted).index_fill_(0, keep_best, True) & wanted
        split, clone = wanted & (widest > large), wanted & (widest <= large)
        new = {name: tensor.detach()[clone] for name, tensor in surfels.tensors().items()}
        parents = {name: tensor.detach()[split].repeat(2, *[1] * (tensor.dim() - 1)) for name, tensor in surfels.tensors().items()}
        spread = torch.randn(len(parents["positions"]), 2, generator=generator).to(gradient.device)
        offsets = spread * parents["log_scales"].exp()
        axes = rotation_matrices(parents["quaternions"])[:, :, :2]
        parents["positions"] = parents["positions"] + (axes @ offsets[:, :, None])[:, :, 0]
        parents["log_scales"] = parents["log_scales"] - float(np.log(SPLIT_SHRINKAGE))
        optimizer.keep_and_append(~gone & ~split, {name: torch.cat([new[name], parents[name]]) for name in new})


def reset_opacity(surfels: Surfels, optimizer: ResizableAdam, opacity: float) -> None:
    """Lower every opacity to at most `opacity`, so that only the surfels that the images need regain theirs."""
    ceiling = float(np.log(opacity / (1 - opacity)))
    with torch.no_grad():
        surfels.opacity_logits.clamp_(max=ceiling)
    optimizer.reset_moments("opacity_logits")
