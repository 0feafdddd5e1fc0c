"""What is compared with the reference of FoundationPose: sizes of small networks, their parameters, and their inputs."""

from collections.abc import Mapping

import torch

from helpers.seeded import seeded_state, seeded_tensor

SMALL = {"stem": 8, "width": 12, "tokens": 24, "heads": 2, "hidden": 20}
PAIRS, SIDE_PX = 5, 48


def parameters(state: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Random parameters and running statistics by name; the table of positions and the counters are as they are in `state`."""
    fixed = {name: tensor for name, tensor in state.items() if name.endswith(("pe", "num_batches_tracked"))}
    drawn = seeded_state({name: tuple(tensor.shape) for name, tensor in state.items() if name not in fixed})
    for name in drawn:
        if name.endswith("running_var"):
            drawn[name] = 1.0 + drawn[name].abs()
        elif name.startswith(("att", "linear")):
            drawn[name] = 1.5 * drawn[name]  # otherwise all poses get nearly the same score
    return drawn | fixed


def pairs(count: int = PAIRS, side_px: int = SIDE_PX) -> tuple[torch.Tensor, torch.Tensor]:
    """Images of noise of different strengths, (count, 6, side, side): of renderings, and of a photo."""
    strength = torch.linspace(0.2, 1.5, count)[:, None, None, None]
    first, second = (seeded_tensor(f"{name} images", (count, 6, side_px, side_px)) for name in ("rendered", "observed"))
    return strength * first, strength.flip(0) * second


def lines(state: Mapping[str, torch.Tensor]) -> list[str]:
    """Names and shapes: `linear.weight 1x512`; what has no sides is a scalar."""
    return [f"{name} {'x'.join(map(str, tensor.shape)) or 'scalar'}" for name, tensor in state.items()]
