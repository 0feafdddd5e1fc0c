"""The network: a backbone, a pyramid of three sizes, and heads for boxes, likelihoods and masks."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.inert_pickles import Shell, read_inert
from zeroshop_steps.networks.weights import load_strictly, read_own_sizes
from zeroshop_steps.runtime.errors import StepError

MODULES = ("ema", "model")  # where the checkpoint has its network: the averaged one if there is one
NAME = "FastSAM-x.pt"
SIZES = ".json"
"""Suffix of the file beside weights that tells the sizes of a network of one's own, such as FastSAM-s."""
STRIDES = (8, 16, 32)  # of the three sizes, in pixels


@dataclass(frozen=True)
class FastSamSettings:
    """Sizes of the network; by default those of the published one.

    Attributes:
        width: factor of all channels.
        depth: factor of the numbers of repeated units.
        most_channels: before the factor.
        bins: in which the distance of a side of a box from its cell is told, in strides.
        prototypes: of masks, which a box mixes.
    """

    width: float = 1.25
    depth: float = 1.0
    most_channels: int = 512
    bins: int = 16
    prototypes: int = 32

    def channels(self, count: int) -> int:
        """Of a layer that has so many at a width of 1: a multiple of eight."""
        return int(-(-min(count, self.most_channels) * self.width // 8) * 8)

    def repeats(self, count: int) -> int:
        """Of a unit that is repeated so often at a depth of 1."""
        return max(round(count * self.depth), 1)


@dataclass(frozen=True)
class BoxCandidates:
    """N boxes of an image.

    Attributes:
        boxes: (N, 4) left, top, right, bottom in pixels.
        likelihoods: (N,) 0..1, of showing one thing.
        mixtures: (N, P) of the prototypes.
        prototypes: (P, height / 4, width / 4).
    """

    boxes: Tensor
    likelihoods: Tensor
    mixtures: Tensor
    prototypes: Tensor


class Convolution(nn.Module):
    """A convolution, normalised, and SiLU."""

    def __init__(self, channels: int, out: int, kernel: int = 1, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, out, kernel, stride, kernel // 2, bias=False)
        self.bn = nn.BatchNorm2d(out, eps=1e-3)

    def forward(self, x: Tensor) -> Tensor:
        return F.silu(self.bn(self.conv(x)))


class Bottleneck(nn.Module):
    """Two convolutions, added to what was there where there is a shortcut."""

    def __init__(self, channels: int, shortcut: bool) -> None:
        super().__init__()
        self.cv1 = Convolution(channels, channels, 3)
        self.cv2 = Convolution(channels, channels, 3)
        self._shortcut = shortcut

    def forward(self, x: Tensor) -> Tensor:
        changed = self.cv2(self.cv1(x))
        return x + changed if self._shortcut else changed


class SplitStage(nn.Module):
    """Half of the channels go through bottlenecks one after the other; all that comes up on the way is put together (C2f)."""

    def __init__(self, channels: int, out: int, repeats: int, shortcut: bool) -> None:
        super().__init__()
        half = out // 2
        self.cv1 = Convolution(channels, 2 * half)
        self.cv2 = Convolution((2 + repeats) * half, out)
        self.m = nn.ModuleList(Bottleneck(half, shortcut) for _ in range(repeats))

    def forward(self, x: Tensor) -> Tensor:
        parts = list(self.cv1(x).chunk(2, 1))
        for unit in self.m:
            parts.append(unit(parts[-1]))
        return self.cv2(torch.cat(parts, 1))


class SpatialPyramid(nn.Module):
    """Maxima over ever larger windows, put together (SPPF)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.cv1 = Convolution(channels, channels // 2)
        self.cv2 = Convolution(channels // 2 * 4, channels)

    def forward(self, x: Tensor) -> Tensor:
        parts = [self.cv1(x)]
        for _ in range(3):
            parts.append(F.max_pool2d(parts[-1], 5, 1, 2))
        return self.cv2(torch.cat(parts, 1))


class Prototypes(nn.Module):
    """Masks that boxes mix, at twice the resolution of the finest size."""

    def __init__(self, channels: int, between: int, out: int) -> None:
        super().__init__()
        self.cv1 = Convolution(channels, between, 3)
        self.upsample = nn.ConvTranspose2d(between, between, 2, 2)
        self.cv2 = Convolution(between, between, 3)
        self.cv3 = Convolution(between, out)

    def forward(self, x: Tensor) -> Tensor:
        return self.cv3(self.cv2(self.upsample(self.cv1(x))))


class ExpectedDistance(nn.Module):
    """The expectation of a distance over its bins, of (B, 4 bins, N) logits as (B, 4, N)."""

    def __init__(self, bins: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(bins, 1, 1, bias=False)

    def forward(self, logits: Tensor) -> Tensor:
        return self.conv(logits.unflatten(1, (4, -1)).transpose(1, 2).softmax(1))[:, 0]


class Head(nn.Module):
    """Boxes, likelihoods and mixtures of masks, of every cell of three sizes."""

    def __init__(self, sizes: Sequence[int], settings: FastSamSettings) -> None:
        super().__init__()

        def branch(channels: int, between: int, out: int) -> nn.Sequential:
            return nn.Sequential(Convolution(channels, between, 3), Convolution(between, between, 3), nn.Conv2d(between, out, 1))

        sides, masks = 4 * settings.bins, settings.prototypes
        self.cv2 = nn.ModuleList(branch(size, max(sizes[0] // 4, sides), sides) for size in sizes)
        self.cv3 = nn.ModuleList(branch(size, sizes[0], 1) for size in sizes)
        self.dfl = ExpectedDistance(settings.bins)
        self.proto = Prototypes(sizes[0], settings.channels(256), masks)
        self.cv4 = nn.ModuleList(branch(size, max(sizes[0] // 4, masks), masks) for size in sizes)

    def forward(self, pyramid: Sequence[Tensor]) -> list[BoxCandidates]:
        """Of each image of (B, C, h, w) layers, the finest first.

        What the layers say is read in single precision whatever the rest does: half of it rounds distances by up to two pixels.
        """
        logits, odds, mixtures = (_join(branches, pyramid).float() for branches in (self.cv2, self.cv3, self.cv4))
        prototypes = self.proto(pyramid[0]).float()
        with torch.autocast(logits.device.type, enabled=False):
            distances = self.dfl(logits)
        likelihoods, mixtures = odds.sigmoid()[:, 0], mixtures.transpose(1, 2)
        centres, strides = locate_cells(pyramid)
        boxes = torch.cat([centres - distances[:, :2], centres + distances[:, 2:]], 1) * strides
        parts = boxes.transpose(1, 2), likelihoods, mixtures, prototypes
        return [BoxCandidates(*one) for one in zip(*parts, strict=True)]


class FastSam(nn.Module):
    """The whole network. Its layers are numbered as in the checkpoint, where some numbers are of layers without parameters."""

    def __init__(self, settings: FastSamSettings | None = None) -> None:
        super().__init__()
        settings = settings or FastSamSettings()
        widths = [settings.channels(count) for count in (64, 128, 256, 512, 1024)]
        few, many = settings.repeats(3), settings.repeats(6)
        layers: dict[str, nn.Module] = {
            "0": Convolution(3, widths[0], 3, 2),
            "1": Convolution(widths[0], widths[1], 3, 2),
            "2": SplitStage(widths[1], widths[1], few, True),
            "3": Convolution(widths[1], widths[2], 3, 2),
            "4": SplitStage(widths[2], widths[2], many, True),
            "5": Convolution(widths[2], widths[3], 3, 2),
            "6": SplitStage(widths[3], widths[3], many, True),
            "7": Convolution(widths[3], widths[4], 3, 2),
            "8": SplitStage(widths[4], widths[4], few, True),
            "9": SpatialPyramid(widths[4]),
            "12": SplitStage(widths[4] + widths[3], widths[3], few, False),
            "15": SplitStage(widths[3] + widths[2], widths[2], few, False),
            "16": Convolution(widths[2], widths[2], 3, 2),
            "18": SplitStage(widths[2] + widths[3], widths[3], few, False),
            "19": Convolution(widths[3], widths[3], 3, 2),
            "21": SplitStage(widths[3] + widths[4], widths[4], few, False),
            "22": Head((widths[2], widths[3], widths[4]), settings),
        }
        self.model = nn.ModuleDict(layers)

    def forward(self, images: Tensor) -> list[BoxCandidates]:
        """(B, 3, height, width) RGB images, 0..1, whose sides are multiples of 32, to the candidates of each."""
        layers = self.model
        fine = _run(layers, ("0", "1", "2", "3", "4"), images)
        middle = _run(layers, ("5", "6"), fine)
        coarse = _run(layers, ("7", "8", "9"), middle)
        middle = layers["12"](torch.cat([_enlarge(coarse), middle], 1))
        fine = layers["15"](torch.cat([_enlarge(middle), fine], 1))
        middle = layers["18"](torch.cat([layers["16"](fine), middle], 1))
        coarse = layers["21"](torch.cat([layers["19"](middle), coarse], 1))
        found: list[BoxCandidates] = layers["22"]([fine, middle, coarse])
        return found


def locate_cells(pyramid: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """(2, N) centres of all cells, x and y in strides, and (N,) strides."""
    centres, strides = [], []
    for layer, stride in zip(pyramid, STRIDES, strict=True):
        y, x = torch.meshgrid(*(torch.arange(side, device=layer.device) + 0.5 for side in layer.shape[2:]), indexing="ij")
        centres.append(torch.stack([x.flatten(), y.flatten()]))
        strides.append(torch.full_like(centres[-1][0], stride))
    return torch.cat(centres, 1), torch.cat(strides)


def load_fastsam(path: Path, settings: FastSamSettings | None = None) -> FastSam:
    """The network with the weights in `path`.

    Args:
        path: the checkpoint.
        settings: its sizes; by default those in a JSON file of the same stem beside it, or else the published ones.

    Raises:
        StepError: the weights are damaged or of another network.
    """
    network = FastSam(settings or read_own_sizes(path.with_suffix(SIZES), FastSamSettings))
    load_strictly(network, path, read=read_pickled_modules)
    return network.eval().requires_grad_(False)


def _join(branches: nn.ModuleList, pyramid: Sequence[Tensor]) -> Tensor:
    """(B, C, N) of all cells of all sizes."""
    return torch.cat([branch(layer).flatten(2) for branch, layer in zip(branches, pyramid, strict=True)], 2)


def _run(layers: nn.ModuleDict, names: Sequence[str], x: Tensor) -> Tensor:
    for name in names:
        x = layers[name](x)
    return x


def _enlarge(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="nearest")


def read_pickled_modules(path: Path) -> dict[str, torch.Tensor]:
    """The parameters and buffers of a pickled network by name, in single precision where they are numbers with a fraction.

    Raises:
        StepError: the file is not there, damaged, cut short, or no such checkpoint.
    """
    path = Path(path)
    try:
        content = read_inert(path)
    except FileNotFoundError:
        raise StepError(f"the weights {path} do not exist") from None
    except ValueError as error:
        raise StepError(f"{path} is no whole checkpoint ({error}); it is damaged or was cut short. Delete it and fetch it again") from None
    found = next((content[key] for key in MODULES if isinstance(content.get(key), Shell)), None) if isinstance(content, dict) else None
    if found is None:
        raise StepError(f"{path} holds no network; it is not a checkpoint of this kind. Take the one that weights.csv names")
    return {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in _list_tensors(found, "")}


def _list_tensors(module: Shell, prefix: str) -> list[tuple[str, torch.Tensor]]:
    """Names as `state_dict` gives them."""
    parts = [part for kind in ("_parameters", "_buffers") for part in (module.state.get(kind) or {}).items()]
    found = [(prefix + name, tensor) for name, tensor in parts if isinstance(tensor, torch.Tensor)]
    for name, child in (module.state.get("_modules") or {}).items():
        if isinstance(child, Shell):
            found += _list_tensors(child, f"{prefix}{name}.")
    return found
