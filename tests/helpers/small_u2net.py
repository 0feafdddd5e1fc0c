"""U²-Net with few channels and random weights, and its ONNX file."""

import warnings
from pathlib import Path

import torch

from u2net import U2Net


def make_small(seed: int = 0) -> U2Net:
    """The network, with weights by a seed."""
    torch.manual_seed(seed)
    return U2Net(width=4, hidden=2)


def export_small(path: Path, height_px: int, width_px: int) -> Path:
    """Write its file, of log odds, by PyTorch's older exporter: the newer one needs packages that nothing else here does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's age, and that sizes become constants, which is meant
        torch.onnx.export(make_small(), (torch.zeros(1, 3, height_px, width_px),), path, dynamo=False)
    return path
