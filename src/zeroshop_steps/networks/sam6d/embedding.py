"""Embeddings of the geometry of a cloud: of pairs of points (GeoTransformer), and of a point's surroundings (PointNet++)."""

import itertools
import math
from collections import OrderedDict

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.sam6d.points import find_in_balls, measure_square_distances, take

DISTANCE_STEP, ANGLE_STEP_DEG = 0.2, 15.0  # differences that change an embedding clearly; distances are in radii of the object
BALL_CHANNELS = (6, 32, 64, 128)  # of a neighbour: from its place against the point and its own to its feature
BALLS = ((0.1, 32), (0.2, 64))  # radii, in those of the object, and numbers of neighbours


class SinusoidalEmbedding(nn.Module):
    """Sines and cosines of a number, in turn."""

    div_term: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("div_term", torch.exp(torch.arange(0, channels, 2).float() * (-math.log(10000.0) / channels)))

    def forward(self, numbers: Tensor) -> Tensor:
        """(...) to (..., C)."""
        waves = numbers[..., None] * self.div_term
        return torch.stack([waves.sin(), waves.cos()], -1).flatten(-2)


class PairEmbedding(nn.Module):
    """(B, N, N, C) of (B, N, 3) points: the distance of each pair, and its direction against the nearest neighbours of the first."""

    def __init__(self, channels: int, neighbours: int) -> None:
        super().__init__()
        self.neighbours = neighbours
        self.embedding = SinusoidalEmbedding(channels)
        self.proj_d = nn.Linear(channels, channels)
        self.proj_a = nn.Linear(channels, channels)

    def forward(self, points: Tensor) -> Tensor:
        distances = measure_square_distances(points, points).sqrt()
        nearest = distances.topk(self.neighbours + 1, dim=2, largest=False).indices[..., 1:]
        across = points[:, None] - points[:, :, None]
        embedded = None  # the largest over the neighbours, one after the other: all of them at once would take several times the memory
        for neighbour in nearest.unbind(2):
            towards = (take(points, neighbour) - points)[:, :, None].expand_as(across)
            angles = torch.atan2(torch.linalg.norm(torch.linalg.cross(towards, across), dim=-1), (towards * across).sum(-1))
            one = self.proj_a(self.embedding(angles * (180.0 / (ANGLE_STEP_DEG * math.pi))))
            embedded = one if embedded is None else torch.maximum(embedded, one)
        assert embedded is not None
        return self.proj_d(self.embedding(distances / DISTANCE_STEP)) + embedded


class PointwiseUnit(nn.Module):
    """A linear layer over the channels of (B, C, N, K) values, normalised, and a ReLU."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, out, 1, bias=False)
        self.normlayer = nn.Sequential(OrderedDict(bn=nn.BatchNorm2d(out)))

    def forward(self, values: Tensor) -> Tensor:
        return torch.relu(self.normlayer(self.conv(values)))


class SurroundingsEmbedding(nn.Module):
    """(B, N, C) of (B, N, 3) points: what lies in a small and in a larger ball around each."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mlp1, self.mlp2 = (
            nn.Sequential(
                OrderedDict((f"layer{step}", PointwiseUnit(*pair)) for step, pair in enumerate(itertools.pairwise(BALL_CHANNELS)))
            )
            for _ in BALLS
        )
        self.mlp3 = nn.Sequential(OrderedDict(conv=nn.Conv1d(2 * BALL_CHANNELS[-1], channels, 1)))

    def forward(self, points: Tensor) -> Tensor:
        found = []
        for mlp, (radius, count) in zip((self.mlp1, self.mlp2), BALLS, strict=True):
            indices = find_in_balls(points, radius, count)
            places = take(points, indices.flatten(1)).unflatten(1, indices.shape[1:])
            grouped = torch.cat([places - points[:, :, None], places], -1).permute(0, 3, 1, 2)
            found.append(mlp(grouped).amax(3))
        return self.mlp3(torch.cat(found, 1)).transpose(1, 2)
