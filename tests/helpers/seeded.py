"""Random parameters and inputs that are the same in every process and for every code that gives its parameters these names."""

import zlib
from collections.abc import Mapping

import numpy as np
import torch


def seeded_tensor(name: str, shape: tuple[int, ...], scale: float = 1.0) -> torch.Tensor:
    """Normally distributed numbers that depend on the name and the shape alone."""
    generator = np.random.Generator(np.random.PCG64(zlib.crc32(f"{name} {shape}".encode())))
    return torch.from_numpy(generator.standard_normal(shape, dtype=np.float32) * np.float32(scale))


def seeded_state(shapes: Mapping[str, tuple[int, ...]], aliases: Mapping[str, str] | None = None) -> dict[str, torch.Tensor]:
    """Parameters by name: weights of unit gain, norms about 1, all else small; `aliases` are second names of the same tensor."""
    state = {}
    for name, shape in shapes.items():
        source = (aliases or {}).get(name, name)
        if len(shape) > 1:
            state[name] = seeded_tensor(source, shape, scale=float(np.prod(shape[1:])) ** -0.5)
        else:
            state[name] = seeded_tensor(source, shape, scale=0.1) + (1.0 if name.endswith("weight") else 0.0)
    return state


def relative_error(found: torch.Tensor, expected: torch.Tensor) -> float:
    """The largest difference, as a share of the largest value that is expected."""
    return float((found.double() - expected.double()).abs().max() / expected.double().abs().max())
