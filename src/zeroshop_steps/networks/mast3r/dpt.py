"""The head that makes a picture from tokens: a dense prediction transformer (Ranftl et al. 2021, section 3)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.layers import FeatureFusion, PlainUnit, resize_map


class Scratch(nn.Module):
    """What fuses the four levels. The checkpoint has the convolutions of the levels under two names each."""

    refinenet4: FeatureFusion

    def __init__(self, level_channels: Sequence[int], features: int) -> None:
        super().__init__()
        for level, channels in enumerate(level_channels, start=1):
            setattr(self, f"layer{level}_rn", nn.Conv2d(channels, features, 3, padding=1, bias=False))
        self.layer_rn = nn.ModuleList(getattr(self, f"layer{level}_rn") for level in range(1, 5))
        for level in range(1, 5):
            setattr(self, f"refinenet{level}", FeatureFusion(features, False, PlainUnit))

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        levels = [convolution(level) for convolution, level in zip(self.layer_rn, levels, strict=True)]
        height, width = levels[2].shape[2:]
        x = self.refinenet4(levels[3], None, double_size(levels[3]))[:, :, :height, :width]  # one row too many where the grid is odd
        for level in (3, 2, 1):
            x = getattr(self, f"refinenet{level}")(x, levels[level - 1], double_size(x))
        return x


class DensePrediction(nn.Module):
    """Tokens of four layers to `out` channels at the picture's size; patches of 16 pixels.

    Args:
        token_channels, level_channels: of the four layers, and of what is made of them.
        features: channels where the four are fused.
    """

    def __init__(self, token_channels: Sequence[int], level_channels: Sequence[int], features: int, out: int) -> None:
        super().__init__()
        first, second, third, fourth = (
            nn.Conv2d(channels, level, 1) for channels, level in zip(token_channels, level_channels, strict=True)
        )
        self.act_postprocess = nn.ModuleList(
            [
                nn.Sequential(first, nn.ConvTranspose2d(level_channels[0], level_channels[0], 4, stride=4)),
                nn.Sequential(second, nn.ConvTranspose2d(level_channels[1], level_channels[1], 2, stride=2)),
                nn.Sequential(third),
                nn.Sequential(fourth, nn.Conv2d(level_channels[3], level_channels[3], 3, stride=2, padding=1)),
            ]
        )
        self.scratch = Scratch(level_channels, features)
        self.head = nn.Sequential(
            nn.Conv2d(features, features // 2, 3, padding=1),
            Double(),
            nn.Conv2d(features // 2, features // 2, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(features // 2, out, 1),
        )

    def forward(self, tokens: Sequence[Tensor], rows: int, columns: int) -> Tensor:
        """Four (B, rows * columns, C) to (B, out, 16 rows, 16 columns)."""
        grids = [layer.transpose(1, 2).unflatten(2, (rows, columns)) for layer in tokens]
        levels = [convolutions(grid) for convolutions, grid in zip(self.act_postprocess, grids, strict=True)]
        return self.head(self.scratch(levels))


class Double(nn.Module):
    """Twice the resolution, bilinear, the corners staying where they are."""

    def forward(self, x: Tensor) -> Tensor:
        return resize_map(x, double_size(x))


def double_size(x: Tensor) -> tuple[int, int]:
    """Twice the height and width of a map."""
    return 2 * x.shape[2], 2 * x.shape[3]


def decode_points(raw: Tensor) -> Tensor:
    """(..., 3) raw outputs to points: the direction stays, the distance d becomes exp(d) - 1 (DUSt3R, supplement B)."""
    distance = raw.norm(dim=-1, keepdim=True)
    return raw / distance.clamp(min=1e-8) * torch.expm1(distance)
