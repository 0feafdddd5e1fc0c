"""What is compared with the reference of FastSAM: sizes of a small network, its parameters, and its inputs."""

from collections.abc import Mapping

import torch

from helpers.seeded import seeded_state, seeded_tensor
from zeroshop_steps.networks.fastsam.model import FastSamSettings

SMALL = FastSamSettings(width=0.25, depth=1 / 3, most_channels=1024)
FULL = FastSamSettings()
SIZE_PX = (96, 128)
LEAST_LIKELIHOOD, MOST_IOU, MOST = 0.5, 0.6, 20


def parameters(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, torch.Tensor]:
    """Random parameters by the names of the checkpoint, which keep values near 1; variances are positive, and bins are counted."""
    named = {name: shape for name, shape in shapes.items() if not name.endswith("num_batches_tracked")}
    state = seeded_state(named)
    for name, tensor in state.items():
        if name.endswith("running_var"):
            state[name] = tensor.abs() + 0.5
        elif name.endswith("dfl.conv.weight"):
            state[name] = torch.arange(tensor.shape[1]).float().view(tensor.shape)
        elif name.endswith("conv.weight"):
            state[name] = 1.25 * tensor
    return state


def image(size_px: tuple[int, int] = SIZE_PX) -> torch.Tensor:
    """(1, 3, height, width) noise, 0..1."""
    return torch.special.ndtr(seeded_tensor("image", (1, 3, *size_px)))
