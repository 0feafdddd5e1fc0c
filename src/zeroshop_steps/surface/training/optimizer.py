"""Adam over parameters whose number changes while they are trained."""

from collections.abc import Callable
from typing import Protocol

import torch


class TrainableModel(Protocol):
    """What is trained: named tensors, each an attribute of that name. Its length is the number of its primitives."""

    def __len__(self) -> int: ...

    def tensors(self) -> dict[str, torch.Tensor]:
        """All of them by name."""


class ResizableAdam:
    """Adam (Kingma & Ba 2015) with one learning rate for each tensor. Rows of the tensors may come and go; those that stay keep
    their moments."""

    def __init__(self, model: TrainableModel, learning_rates: dict[str, float], betas: tuple[float, float] = (0.9, 0.999)) -> None:
        self.model = model
        groups = [
            {"params": [tensor.requires_grad_()], "lr": learning_rates[name], "name": name} for name, tensor in model.tensors().items()
        ]
        self.adam = torch.optim.Adam(groups, lr=0.0, betas=betas, eps=1e-15, fused=True)

    def step(self) -> None:
        """Update the tensors, then clear their gradients."""
        self.adam.step()
        self.adam.zero_grad(set_to_none=True)

    def set_learning_rate(self, name: str, value: float) -> None:
        """Change the learning rate of one tensor."""
        next(group for group in self.adam.param_groups if group["name"] == name)["lr"] = value

    def keep_and_append(self, keep: torch.Tensor, new: dict[str, torch.Tensor]) -> None:
        """Keep the rows of the (N,) bool mask and append those of `new`, whose moments begin at zero.

        new: by the name of the tensor, rows of the same trailing shape.
        """
        for name in [group["name"] for group in self.adam.param_groups]:
            self._append(name, keep, new[name])

    def _append(self, name: str, keep: torch.Tensor, rows: torch.Tensor) -> None:
        self.replace_tensor(
            name,
            lambda old: torch.cat([old[keep], rows]),
            lambda moment: torch.cat([moment[keep], torch.zeros_like(rows)]),
        )

    def replace_tensor(
        self, name: str, value: Callable[[torch.Tensor], torch.Tensor], moment: Callable[[torch.Tensor], torch.Tensor]
    ) -> None:
        """Replace a tensor by `value(old)`, and each of its two moments by `moment(old)`."""
        group = next(group for group in self.adam.param_groups if group["name"] == name)
        old = group["params"][0]
        tensor = value(old.detach()).requires_grad_()
        state = self.adam.state.pop(old, None)
        if state:
            for key in ("exp_avg", "exp_avg_sq"):
                state[key] = moment(state[key])
            self.adam.state[tensor] = state
        group["params"][0] = tensor
        setattr(self.model, name, tensor)

    def reset_moments(self, name: str) -> None:
        """Set the moments of one tensor to zero, after its values were set by hand."""
        group = next(group for group in self.adam.param_groups if group["name"] == name)
        for moment in ("exp_avg", "exp_avg_sq"):
            self.adam.state[group["params"][0]][moment].zero_()
