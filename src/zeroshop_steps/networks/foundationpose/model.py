"""The refiner, which says how to move a pose, and the scorer, which ranks poses; parameters have the checkpoints' names and shapes.

Both compare a rendering of the model at a pose with the photo, as (N, 6, H, W) images: colours from 0 to 1, then the camera
coordinates of the points less those of the pose's centre, in radii of the object; 0 where nothing is there.
"""

from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.foundationpose.settings import FoundationPoseSettings
from zeroshop_steps.networks.weights import load_strictly, read_own_sizes

SIZES = ".settings.json"
"""Suffix of the file beside weights that tells the sizes of a network of one's own."""


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


class RefineNet(nn.Module):
    """Says how to move each pose so that its rendering fits the photo (section 3.3 of the paper)."""

    def __init__(self, settings: FoundationPoseSettings | None = None) -> None:
        super().__init__()
        settings = settings or FoundationPoseSettings()
        self.encodeA, self.encodeAB = make_image_encoder(settings), make_pair_encoder(settings)
        self.pos_embed = PositionTable(settings.tokens, settings.most_tokens)
        self.trans_head, self.rot_head = (
            nn.Sequential(
                nn.TransformerEncoderLayer(settings.tokens, settings.heads, settings.hidden, batch_first=True),
                nn.Linear(settings.tokens, 3),
            )
            for _ in range(2)
        )

    def forward(self, rendered: Tensor, observed: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3) translations in radii of the object, and (N, 3) turns before the hyperbolic tangent (`poses.apply_update`)."""
        tokens = encode_pairs(rendered, observed, self.encodeA, self.encodeAB, self.pos_embed)
        return self.trans_head(tokens).mean(1), self.rot_head(tokens).mean(1)


class ScoreNet(nn.Module):
    """Scores poses of one object in one photo in view of each other (section 3.4 of the paper).

    Attention is in single precision whatever the rest does, since half of it gives many poses nearly the same score.
    """

    def __init__(self, settings: FoundationPoseSettings | None = None) -> None:
        super().__init__()
        settings = settings or FoundationPoseSettings()
        self.encoderA, self.encoderAB = make_image_encoder(settings), make_pair_encoder(settings)
        self.att, self.att_cross = (nn.MultiheadAttention(settings.tokens, settings.heads, batch_first=True) for _ in range(2))
        self.pos_embed = PositionTable(settings.tokens, settings.most_tokens)
        self.linear = nn.Linear(settings.tokens, 1)

    def describe(self, rendered: Tensor, observed: Tensor) -> Tensor:
        """(N, tokens) how each pose fits, on its own: these may be computed a few at a time."""
        tokens = encode_pairs(rendered, observed, self.encoderA, self.encoderAB, self.pos_embed)
        with torch.autocast(tokens.device.type, enabled=False):
            tokens = tokens.float()
            return self.att(tokens, tokens, tokens, need_weights=False)[0].mean(1)

    def rank(self, descriptions: Tensor) -> Tensor:
        """(N,) scores, higher is better, of N poses that are compared with each other."""
        with torch.autocast(descriptions.device.type, enabled=False):
            together = descriptions[None].float()
            return self.linear(self.att_cross(together, together, together, need_weights=False)[0]).reshape(-1)

    def forward(self, rendered: Tensor, observed: Tensor) -> Tensor:
        """(N,) scores of N poses, whose images are (N, image_channels, H, W)."""
        return self.rank(self.describe(rendered, observed))


Network = TypeVar("Network", RefineNet, ScoreNet)


def load_network(kind: type[Network], weights: Path, device: torch.device) -> Network:
    """A network with the weights of a file, ready for inference.

    A JSON file of the same stem beside it, if there is one, says the sizes of a network of one's own.

    Raises:
        StepError: the weights are damaged, or of another network.
    """
    with torch.device("meta"):
        network = kind(read_own_sizes(weights.with_suffix(SIZES), FoundationPoseSettings))
    load_strictly(network, weights)
    return network.eval().requires_grad_(False).to(device)
