"""U²-Net in PyTorch, to be trained further; to find objects, its ONNX file is run (salient_object.py).

Qin et al., U2-Net: Going Deeper with Nested U-Structure for Salient Object Detection, Pattern Recognition 2020. Weights are those of an
ONNX file, in which each batch normalization is a part of the convolution before it; so there is none here.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write

if TYPE_CHECKING:
    import onnx

# Dilations of a block's convolutions on the way down, the last one at the bottom, and whether each works at half the size of the last.
BLOCKS = {
    "RSU-7": ((1, 1, 1, 1, 1, 1, 2), True),
    "RSU-6": ((1, 1, 1, 1, 1, 2), True),
    "RSU-5": ((1, 1, 1, 1, 2), True),
    "RSU-4": ((1, 1, 1, 2), True),
    "RSU-4F": ((1, 2, 4, 8), False),
}
STAGES = ("RSU-7", "RSU-6", "RSU-5", "RSU-4", "RSU-4F", "RSU-4F")
WIDTH, HIDDEN = 64, 16
"""Channels between the blocks of u2netp, and those inside of them."""


class ResidualUBlock(nn.Module):
    """A residual U-block (RSU, figure 2 of the paper): a small U-Net, added to what enters it."""

    def __init__(self, kind: str, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        (*dilations, bottom), self.shrinks = BLOCKS[kind]
        self.entry = _convolve(inputs, outputs, 1)
        self.down = nn.ModuleList(_convolve(hidden if level else outputs, hidden, dilation) for level, dilation in enumerate(dilations))
        self.bottom = _convolve(hidden, hidden, bottom)
        self.up = nn.ModuleList(
            _convolve(2 * hidden, hidden if level else outputs, dilation) for level, dilation in reversed(list(enumerate(dilations)))
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H, W)."""
        entered = self.entry(x)
        skips: list[Tensor] = []
        x = entered
        for layer in self.down:
            x = layer(_halve(x) if skips and self.shrinks else x)
            skips.append(x)
        x = self.bottom(x)
        for layer, skip in zip(self.up, reversed(skips), strict=True):
            x = layer(torch.cat([_resize(x, skip), skip], 1))
        return x + entered


class U2Net(nn.Module):
    """The network with one width of channels throughout, as its small version u2netp has it.

    Args:
        width: channels between blocks.
        hidden: channels inside blocks.
    """

    def __init__(self, width: int = WIDTH, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.down = nn.ModuleList(ResidualUBlock(kind, width if stage else 3, hidden, width) for stage, kind in enumerate(STAGES))
        self.up = nn.ModuleList(ResidualUBlock(kind, 2 * width, hidden, width) for kind in reversed(STAGES[:-1]))
        self.sides = nn.ModuleList(nn.Conv2d(width, 1, 3, padding=1) for _ in STAGES)
        self.fuse = nn.Conv2d(len(STAGES), 1, 1)

    def forward(self, images: Tensor) -> list[Tensor]:
        """What each pixel shows.

        Args:
            images: (B, 3, H, W) float32, (level - mean) / deviation.

        Returns:
            (B, 1, H, W) log odds of the object: the answer, then the six side outputs that it was made of, the finest first.
        """
        skips: list[Tensor] = []
        x = images
        for block in self.down:
            x = block(_halve(x) if skips else x)
            skips.append(x)
        seen = [skips.pop()]
        for block, skip in zip(self.up, reversed(skips), strict=True):
            seen.append(block(torch.cat([_resize(seen[-1], skip), skip], 1)))
        sides = [_resize(side(x), images) for side, x in zip(self.sides, reversed(seen), strict=True)]
        return [self.fuse(torch.cat(sides, 1)), *sides]

    def convolutions(self) -> Iterator[nn.Conv2d]:
        """Its convolutions, which hold all of its weights, in the order in which they are used."""
        return (module for module in self.modules() if isinstance(module, nn.Conv2d))


def read_weights(network: U2Net, path: Path) -> None:
    """Give a network the weights of an ONNX file.

    Raises:
        StepError: the file is missing or damaged, or of a network with other layers.
    """
    numpy_helper = _import_onnx().numpy_helper
    stored = _find_stored(_load(path), network, path)
    with torch.no_grad():
        for parameter, tensor in stored:
            parameter.copy_(torch.from_numpy(numpy_helper.to_array(tensor).copy()))


def write_weights(network: U2Net, like: Path, path: Path) -> None:
    """Write an ONNX file with a network's weights, whole or not at all.

    Args:
        network: with the weights.
        like: ONNX file of the same network with other weights, which gives all the rest.
        path: of the new file.

    Raises:
        StepError: as `read_weights`, of `like`.
    """
    model = _load(like)
    for parameter, tensor in _find_stored(model, network, like):
        tensor.CopyFrom(_import_onnx().numpy_helper.from_array(parameter.detach().cpu().numpy(), tensor.name))
    with atomic_write(path) as file:
        file.write_bytes(model.SerializeToString())


def _find_stored(model: "onnx.ModelProto", network: U2Net, path: Path) -> Sequence[tuple[nn.Parameter, "onnx.TensorProto"]]:
    """Each parameter with the tensor of the file that holds it. Names differ from file to file, the order of convolutions does not."""
    tensors = {tensor.name: tensor for tensor in model.graph.initializer}
    names = [name for node in model.graph.node if node.op_type == "Conv" for name in node.input[1:]]
    parameters = [parameter for layer in network.convolutions() for parameter in layer.parameters()]
    found = [tuple(tensors[name].dims) for name in names if name in tensors]
    if found != [tuple(parameter.shape) for parameter in parameters]:
        raise StepError(
            f"{path} has {len(found)} arrays of weights and biases of convolutions, and they are not the {len(parameters)} of U²-Net with"
            f" {network.fuse.in_channels} side outputs, or of other shapes; give the file of this network, u2netp.onnx"
        )
    return list(zip(parameters, (tensors[name] for name in names), strict=True))


def _load(path: Path) -> "onnx.ModelProto":
    onnx = _import_onnx()
    try:
        return onnx.load(path)
    except FileNotFoundError:
        raise StepError(f"the network {path} does not exist; `snakemake {path}` downloads a known one") from None
    except Exception as error:  # what protobuf raises for bytes that are no model has no public name
        raise StepError(f"{path} cannot be read as an ONNX network ({str(error).splitlines()[0]}); download it again") from None


def _import_onnx() -> Any:
    """The package, which only training needs."""
    try:
        import onnx
    except ImportError:
        raise StepError("reading and writing the weights of ONNX files needs the package onnx: `pip install onnx`") from None
    return onnx


def _convolve(inputs: int, outputs: int, dilation: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, padding=dilation, dilation=dilation), nn.ReLU())


def _halve(x: Tensor) -> Tensor:
    return F.max_pool2d(x, 2, ceil_mode=True)


def _resize(x: Tensor, like: Tensor) -> Tensor:
    """`x` at the height and width of another tensor."""
    return x if x.shape[2:] == like.shape[2:] else F.interpolate(x, like.shape[2:], mode="bilinear", align_corners=False)
