"""Adaptive density control: where the image asks for more disks, and which disks do nothing (Kerbl et al. 2023, sec. 5.2)."""

import numpy as np
import torch

from zeroshop_steps.surface.optimizer import ResizableAdam
from zeroshop_steps.surface.twodgs.surfels import rotation_matrices


class GradientMeter:
    """Mean length of each disk's screen-space gradient over the views that drew it since the last densification."""

    def __init__(self, count: int) -> None:
        self.total, self.views = np.zeros(count), np.zeros(count)

    def add(self, gradient: np.ndarray, visible: np.ndarray) -> None:
        """Count one view: (N,) gradient lengths and (N,) which were drawn."""
        self.total[visible] += gradient[visible]
        self.views += visible

    def mean(self) -> np.ndarray:
        """(N,) means, zero for disks that no view drew."""
        return self.total / np.maximum(self.views, 1)


def densify_and_prune(
    optimizer: ResizableAdam, meter: GradientMeter, threshold: float, large: float, opacity_min: float, doomed: np.ndarray,
    count_max: int, generator: torch.Generator,
) -> None:  # fmt: skip
    """Clone small disks and split large ones where the mean gradient passes the threshold; drop faint and doomed ones.

    Args:
        threshold: gradient, in loss per pixel of shift summed over the image's pixels.
        large: scale, in normalized units, from which a disk is split into two rather than cloned.
        opacity_min: disks fainter than this are dropped.
        doomed: (N,) bool, disks to drop for other reasons, such as lying outside the masks.
        count_max: where more disks qualify than this leaves room for, those with the largest gradients win.
    """
    surfels = optimizer.model
    with torch.no_grad():
        scales = surfels.log_scales.exp()
        widest = scales.max(dim=1).values
        faint = torch.sigmoid(surfels.opacity_logits) < opacity_min
        gone = faint | torch.from_numpy(doomed)
        gradient = torch.from_numpy(meter.mean())
        gradient[gone] = 0.0
        room = max(count_max - int((~gone).sum()), 0)
        wanted = gradient > threshold
        if int(wanted.sum()) > room:
            keep_best = torch.argsort(gradient, descending=True, stable=True)[:room]
            wanted = torch.zeros_like(wanted).index_fill_(0, keep_best, True) & wanted
        split, clone = wanted & (widest > large), wanted & (widest <= large)
        new = {name: tensor.detach()[clone] for name, tensor in surfels.tensors().items()}
        parents = {name: tensor.detach()[split].repeat(2, *[1] * (tensor.dim() - 1)) for name, tensor in surfels.tensors().items()}
        offsets = torch.randn(len(parents["positions"]), 2, generator=generator) * parents["log_scales"].exp()
        axes = rotation_matrices(parents["quaternions"])[:, :, :2]
        parents["positions"] = parents["positions"] + (axes @ offsets[:, :, None])[:, :, 0]
        parents["log_scales"] = parents["log_scales"] - float(np.log(1.6))
        optimizer.keep_and_append(~gone & ~split, {name: torch.cat([new[name], parents[name]]) for name in new})


def reset_opacity(optimizer: ResizableAdam, opacity: float) -> None:
    """Lower every opacity to at most `opacity`, so that only the disks that the images need come back."""
    ceiling = float(np.log(opacity / (1 - opacity)))
    with torch.no_grad():
        optimizer.model.opacity_logits.clamp_(max=ceiling)
    optimizer.reset_moments("opacity_logits")
