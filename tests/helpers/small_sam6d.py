"""SAM-6D's pose estimation in a small size with random weights, in a file like the published one."""

from dataclasses import asdict
from pathlib import Path

import torch

from helpers.sam6d_cases import SMALL, parameters
from zeroshop_steps.networks.sam6d.model import SIZES, Sam6dPem
from zeroshop_steps.runtime.files import write_json


def write_pem(path: Path) -> Path:
    """The weights, with their sizes beside them."""
    network = Sam6dPem(SMALL)
    network.load_state_dict(parameters({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}), strict=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(network.state_dict(), path)
    write_json(path.with_suffix(SIZES), asdict(SMALL))
    return path
