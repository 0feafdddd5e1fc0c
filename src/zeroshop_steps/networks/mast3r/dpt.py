"""The head that makes a picture from tokens: a dense prediction transformer (Ranftl et al. 2021, section 3)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

# Sizes of the published network; its checkpoint has them.
LEVEL_CHANNELS = (96, 192, 384, 768)
FEATURES = 256
LAST_FEATURES = 128


class ResidualUnit(nn.Module):
    """Two convolutions, each after a ReLU, added to what came in."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(FEATURES, FEATURES, 3, padding=1)
        self.conv2 = nn.Conv2d(FEATURES, FEATURES, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class FeatureFusion(nn.Module):
    """Adds a finer level to what the coarser ones have come to, and doubles the resolution.

    The coarsest has nothing to be added to it; its first unit is in the checkpoint all the same.
    """

    def __init__(self) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(FEATURES, FEATURES, 1)
        self.resConfUnit1 = ResidualUnit()
        self.resConfUnit2 = ResidualUnit()

    def forward(self, x: Tensor, finer: Tensor | None = None) -> Tensor:
        if finer is not None:
            x = x + self.resConfUnit1(finer)
        return self.out_conv(double(self.resConfUnit2(x)))


class Scratch(nn.Module):
    """What fuses the four levels. The checkpoint has the convolutions of the levels under two names each."""

    def __init__(self) -> None:
        super().__init__()
        for level, channels in enumerate(LEVEL_CHANNELS, start=1):
            setattr(self, f"layer{level}_rn", nn.Conv2d(channels, FEATURES, 3, padding=1, bias=False))
        self.layer_rn = nn.ModuleList(getattr(self, f"layer{level}_rn") for level in range(1, 5))
        self.refinenet1, self.refinenet2, self.refinenet3, self.refinenet4 = (
            FeatureFusion(),
            FeatureFusion(),
            FeatureFusion(),
            FeatureFusion(),
        )

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        levels = [convolution(level) for convolution, level in zip(self.layer_rn, levels, strict=True)]
        height, width = levels[2].shape[2:]
        x = self.refinenet4(levels[3])[:, :, :height, :width]  # one row or column too many where the grid is odd
        x = self.refinenet3(x, levels[2])
        x = self.refinenet2(x, levels[1])
        return self.refinenet1(x, levels[0])


class DensePrediction(nn.Module):
    """Tokens of four layers to `out` channels at the picture's size; patches of 16 pixels."""

    def __init__(self, token_channels: Sequence[int], out: int) -> None:
        super().__init__()
        first, second, third, fourth = (
            nn.Conv2d(channels, level, 1) for channels, level in zip(token_channels, LEVEL_CHANNELS, strict=True)
        )
        self.act_postprocess = nn.ModuleList(
            [
                nn.Sequential(first, nn.ConvTranspose2d(LEVEL_CHANNELS[0], LEVEL_CHANNELS[0], 4, stride=4)),
                nn.Sequential(second, nn.ConvTranspose2d(LEVEL_CHANNELS[1], LEVEL_CHANNELS[1], 2, stride=2)),
                nn.Sequential(third),
                nn.Sequential(fourth, nn.Conv2d(LEVEL_CHANNELS[3], LEVEL_CHANNELS[3], 3, stride=2, padding=1)),
            ]
        )
        self.scratch = Scratch()
        self.head = nn.Sequential(
            nn.Conv2d(FEATURES, LAST_FEATURES, 3, padding=1),
            Double(),
            nn.Conv2d(LAST_FEATURES, LAST_FEATURES, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(LAST_FEATURES, out, 1),
        )

    def forward(self, tokens: Sequence[Tensor], rows: int, columns: int) -> Tensor:
        """Four (B, rows * columns, C) to (B, out, 16 rows, 16 columns)."""
        grids = [layer.transpose(1, 2).unflatten(2, (rows, columns)) for layer in tokens]
        levels = [convolutions(grid) for convolutions, grid in zip(self.act_postprocess, grids, strict=True)]
        return self.head(self.scratch(levels))


class Double(nn.Module):
    """`double` as a layer."""

    def forward(self, x: Tensor) -> Tensor:
        return double(x)


def double(x: Tensor) -> Tensor:
    """Twice the resolution, bilinear, the corners staying where they are."""
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)


def decode_points(raw: Tensor) -> Tensor:
    """(..., 3) raw outputs to points: the direction stays, the distance d becomes exp(d) - 1 (DUSt3R, supplement B)."""
    distance = raw.norm(dim=-1, keepdim=True)
    return raw / distance.clamp(min=1e-8) * torch.expm1(distance)
