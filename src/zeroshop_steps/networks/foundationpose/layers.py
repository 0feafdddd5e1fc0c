"""What the refiner and the scorer share: the encoder of a pair of images, under the names that the checkpoints use."""

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.foundationpose.settings import FoundationPoseSettings


class ConvUnit(nn.Module):
    """A convolution that keeps the size but for its stride, batch normalisation and a ReLU."""

    def __init__(self, channels: int, out: int, kernel: int, stride: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Conv2d(channels, out, kernel, stride, padding=kernel // 2), nn.BatchNorm2d(out), nn.ReLU(inplace=True))

    def forward(self, x: Tensor) -> Tensor:
        return self.net(x)


class ResidualUnit(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut (He et al. 2016)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1, self.conv2 = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))
        self.bn1, self.bn2 = nn.BatchNorm2d(channels), nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        inner = torch.relu(self.bn1(self.conv1(x)))
        return torch.relu(self.bn2(self.conv2(inner)) + x)


class PositionTable(nn.Module):
    """Sines and cosines that tell a token its place; a buffer, which the checkpoints hold, too."""

    pe: Tensor

    def __init__(self, width: int, most_tokens: int) -> None:
        super().__init__()
        places = torch.arange(most_tokens, dtype=torch.float32)[:, None]
        # Wavelengths of up to 10000 tokens over 2 pi (Vaswani et al. 2017).
        rates = torch.exp(torch.arange(0, width, 2, dtype=torch.float32) * (-torch.log(torch.tensor(10000.0)) / width))
        self.register_buffer("pe", torch.stack([torch.sin(places * rates), torch.cos(places * rates)], dim=2).flatten(1)[None])

    def forward(self, tokens: Tensor) -> Tensor:
        return tokens + self.pe[:, : tokens.shape[1]]


def make_image_encoder(settings: FoundationPoseSettings) -> nn.Sequential:
    """Encodes each image of a pair: (N, image_channels, H, W) to (N, width, H / 4, W / 4)."""
    return nn.Sequential(
        ConvUnit(settings.image_channels, settings.stem, kernel=7, stride=2),
        ConvUnit(settings.stem, settings.width, kernel=3, stride=2),
        ResidualUnit(settings.width),
        ResidualUnit(settings.width),
    )


def make_pair_encoder(settings: FoundationPoseSettings) -> nn.Sequential:
    """Encodes the features of both together: (N, 2 * width, H / 4, W / 4) to (N, tokens, H / 8, W / 8)."""
    return nn.Sequential(
        ResidualUnit(2 * settings.width),
        ResidualUnit(2 * settings.width),
        ConvUnit(2 * settings.width, settings.tokens, kernel=3, stride=2),
        ResidualUnit(settings.tokens),
        ResidualUnit(settings.tokens),
    )


def encode_pairs(rendered: Tensor, observed: Tensor, image_encoder: nn.Module, pair_encoder: nn.Module, positions: nn.Module) -> Tensor:
    """(N, T, tokens) of N pairs of images, (N, image_channels, H, W) each; T = H / 8 * W / 8, row by row."""
    first, second = image_encoder(torch.cat([rendered, observed])).chunk(2)
    return positions(pair_encoder(torch.cat([first, second], dim=1)).flatten(2).transpose(1, 2))
