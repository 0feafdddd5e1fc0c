"""Adaptive density control: where the image asks for more disks, and which disks do nothing (Kerbl et al. 2023, sec. 5.2)."""

import numpy as np
import torch

from zeroshop_steps.nvs.twodgs.reference import rotation_matrices
from zeroshop_steps.nvs.twodgs.surfels import Surfels


class AdamWithSurgery:
    """Adam (Kingma & Ba 2015) over surfels whose number changes: moments follow the disks that stay, new disks start with none."""

    def __init__(self, surfels: Surfels, learning_rates: dict[str, float]) -> None:
        self.surfels = surfels
        groups = [
            {"params": [tensor.requires_grad_()], "lr": learning_rates[name], "name": name} for name, tensor in surfels.tensors().items()
        ]
        self.adam = torch.optim.Adam(groups, lr=0.0, eps=1e-15, fused=True)

    def step(self) -> None:
        """One update, then the gradients are forgotten."""
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)

    def set_learning_rate(self, name: str, value: float) -> None:
        """Change the rate of one group."""
        next(group for group in self.adam.param_groups if group["name"] == name)["lr"] = value

    def rebuild(self, keep: torch.Tensor, new: dict[str, torch.Tensor]) -> None:
        """Keep the disks of the (N,) bool mask and append those of `new` (tensors by name, same trailing shapes)."""
        for group in self.adam.param_groups:
            name, old = group["name"], group["params"][0]
            tensor = torch.cat([old.detach()[keep], new[name]]).requires_grad_()
            state = self.adam.state.pop(old, None)
            if state:
                for moment in ("exp_avg", "exp_avg_sq"):
                    state[moment] = torch.cat([state[moment][keep], torch.zeros_like(new[name])])
                self.adam.state[tensor] = state
            group["params"][0] = tensor
            setattr(self.surfels, name, tensor)

    def forget(self, name: str) -> None:
        """Drop the moments of one group, after its values were set by hand."""
        group = next(group for group in self.adam.param_groups if group["name"] == name)
        for moment in ("exp_avg", "exp_avg_sq"):
            self.adam.state[group["params"][0]][moment].zero_()


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
    optimizer: AdamWithSurgery, meter: GradientMeter, threshold: float, large: float, opacity_min: float, doomed: np.ndarray,
    count_max: int, generator: torch.Generator,
) -> None:  # fmt: skip
    """Clone small disks and split large ones where the mean gradient passes the threshold; drop faint, oversized and doomed ones.

    Args:
        threshold: gradient, in loss per pixel of shift summed over the image's pixels.
        large: scale, in normalized units, from which a disk is split into two rather than cloned.
        opacity_min: disks fainter than this are dropped.
        doomed: (N,) bool, disks to drop for other reasons, such as lying outside the masks.
        count_max: where more disks qualify than this leaves room for, those with the largest gradients win.
    """
    surfels = optimizer.surfels
    with torch.no_grad():
        scales = surfels.log_scales.exp()
        widest = scales.max(dim=1).values
        faint = torch.sigmoid(surfels.opacity_logits) < opacity_min
        gone = faint | torch.from_numpy(doomed) | (widest > 0.5)
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
        optimizer.rebuild(~gone & ~split, {name: torch.cat([new[name], parents[name]]) for name in new})


def reset_opacity(optimizer: AdamWithSurgery, opacity: float) -> None:
    """Lower every opacity to at most `opacity`, so that only the disks that the images need come back."""
    ceiling = float(np.log(opacity / (1 - opacity)))
    with torch.no_grad():
        optimizer.surfels.opacity_logits.clamp_(max=ceiling)
    optimizer.forget("opacity_logits")
