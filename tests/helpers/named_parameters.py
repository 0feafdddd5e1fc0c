"""Parameters that depend on their names and shapes alone: the same in any implementation, on any machine."""

import math
import zlib

import numpy as np
import torch
from torch import nn


def noise(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Uniform numbers from -1 to 1, by SplitMix64 (Steele et al. 2014) from the name's CRC-32."""
    with np.errstate(over="ignore"):
        state = (np.arange(1, math.prod(shape) + 1, dtype=np.uint64) + (np.uint64(zlib.crc32(name.encode())) << np.uint64(32))) * np.uint64(
            0x9E3779B97F4A7C15
        )
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state ^= state >> np.uint64(31)
    return ((state >> np.uint64(40)).astype(np.float64) / (1 << 23) - 1).astype(np.float32).reshape(shape)


def fill(module: nn.Module) -> nn.Module:
    """Give every parameter a value of a size that keeps activations near 1; returns the module, ready for inference."""
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            values = noise(name, tuple(parameter.shape))
            if name.endswith("bias"):
                values *= 0.1
            elif name.endswith("gamma"):
                values = 0.5 + 0.3 * values
            elif parameter.ndim == 1:
                values = 1 + 0.2 * values
            elif parameter.ndim == 2 or name.endswith("weight"):
                values *= math.sqrt(3 / math.prod(parameter.shape[1:]))
            if "flow_head" in name:  # large corrections of tracks are chaotic: any rounding error grows (README.md)
                values *= 0.01
            parameter.copy_(torch.from_numpy(values))
    return module.eval()
