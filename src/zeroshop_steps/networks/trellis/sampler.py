"""From noise to data along a flow, by Euler's method with classifier-free guidance."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from zeroshop_steps.networks.trellis.settings import SamplerSettings


def sample_times(settings: SamplerSettings) -> list[float]:
    """The steps + 1 times from 1, noise, to 0, data."""
    even = torch.linspace(1, 0, settings.steps + 1, dtype=torch.float64)
    return (settings.rescale * even / (1 + (settings.rescale - 1) * even)).tolist()


def follow_flow(
    velocity: Callable[[Tensor, Tensor, Tensor], Tensor],
    noise: Tensor,
    conditions: Sequence[Tensor],
    settings: SamplerSettings,
    after_step: Callable[[], None] = lambda: None,
) -> Tensor:
    """What the noise becomes.

    Args:
        velocity: of a state, a time from 1000 to 0, and (T, width) image tokens.
        noise: the state at the start.
        conditions: the tokens of each picture; the steps take them in turns. Zeros in their place are the unguided flow.
        settings: of the steps and the guidance.
        after_step: called after each step.
    """
    times, state = sample_times(settings), noise
    low, high = settings.interval
    for index, (time, following) in enumerate(zip(times, times[1:], strict=False)):
        condition = conditions[index % len(conditions)]
        scaled = torch.tensor(1000.0 * time, dtype=torch.float32, device=state.device)
        speed = velocity(state, scaled, condition)
        if low <= time <= high:
            unguided = velocity(state, scaled, torch.zeros_like(condition))
            speed = (1 + settings.guidance) * speed - settings.guidance * unguided
        state = state - (time - following) * speed
        after_step()
    return state
