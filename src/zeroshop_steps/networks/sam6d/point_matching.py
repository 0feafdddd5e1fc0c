"""Which points of two clouds belong together: few of each first, then many."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.sam6d.attention import GeometricTransformer, LinearAttention, TransformerLayer
from zeroshop_steps.networks.sam6d.embedding import SurroundingsEmbedding
from zeroshop_steps.networks.sam6d.points import take
from zeroshop_steps.networks.sam6d.settings import TEMPERATURE, Sam6dSettings


@dataclass(frozen=True)
class SparseCloud:
    """Few points of a cloud.

    Attributes:
        indices: (B, S) of the points among all.
        points: (B, S, 3).
        features: (B, S, C).
        pairs: (B, 1 + S, 1 + S, C) the geometry of their pairs, behind that of a point far away, which stands for none.
    """

    indices: Tensor
    points: Tensor
    features: Tensor
    pairs: Tensor


class PointMatching(nn.Module):
    """What coarse and fine matching share: points come in with a token for none of them, and go out as likenesses."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.in_proj = nn.Linear(settings.features, settings.channels)
        self.out_proj = nn.Linear(settings.channels, settings.features)
        self.bg_token = nn.Parameter(torch.zeros(1, 1, settings.channels))

    def add_none(self, features: Tensor) -> Tensor:
        """(B, 1 + N, C) of (B, N, C)."""
        return torch.cat([self.bg_token.expand(len(features), -1, -1), features], 1)

    def compare(self, first: Tensor, second: Tensor) -> Tensor:
        """(B, N, M) logits: cosines of what comes out, over the temperature."""
        first, second = (F.normalize(self.out_proj(features), dim=2) for features in (first, second))
        return first @ second.transpose(1, 2) / TEMPERATURE


class CoarseMatching(PointMatching):
    """Sparse points of an image against those of an object."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__(settings)
        self.transformers = nn.ModuleList(GeometricTransformer(settings.channels) for _ in range(settings.blocks))

    def forward(self, seen: SparseCloud, known: SparseCloud) -> Tensor:
        """(B, 1 + S, 1 + S) logits; the first row and column stand for none."""
        first, second = (self.add_none(self.in_proj(cloud.features)) for cloud in (seen, known))
        for transformer in self.transformers:
            first, second = transformer(first, seen.pairs, second, known.pairs)
        return self.compare(first, second)


class SparseToDense(nn.Module):
    """Sparse points look at each other, and then all points of a cloud at its own sparse ones."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.sparse_layer = GeometricTransformer(channels)
        self.dense_layer = TransformerLayer(channels, LinearAttention(channels))

    def forward(self, first: Tensor, second: Tensor, seen: SparseCloud, known: SparseCloud) -> tuple[Tensor, Tensor]:
        """(B, 1 + N, C) each, behind the token for none."""
        # As published and trained, the indices of points are taken for rows that begin with the token for none.
        sparse, other = (torch.cat([dense[:, :1], take(dense, cloud.indices)], 1) for dense, cloud in ((first, seen), (second, known)))
        sparse, other = self.sparse_layer(sparse, seen.pairs, other, known.pairs)
        return self._spread(first, sparse), self._spread(second, other)

    def _spread(self, dense: Tensor, sparse: Tensor) -> Tensor:
        return torch.cat([sparse[:, :1], self.dense_layer(dense[:, 1:], sparse[:, 1:])], 1)


class FineMatching(PointMatching):
    """All points of an image, brought near by a first pose, against those of an object."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__(settings)
        self.PE = SurroundingsEmbedding(settings.channels)
        self.transformers = nn.ModuleList(SparseToDense(settings.channels) for _ in range(settings.blocks))

    def forward(
        self,
        seen_points: Tensor,
        seen_features: Tensor,
        seen: SparseCloud,
        known_points: Tensor,
        known_features: Tensor,
        known: SparseCloud,
    ) -> Tensor:
        """(B, 1 + N, 1 + M) logits; the points of both are in the frame of the model, in radii of the object."""
        first = self.add_none(self.in_proj(seen_features) + self.PE(seen_points))
        second = self.add_none(self.in_proj(known_features) + self.PE(known_points))
        for transformer in self.transformers:
            first, second = transformer(first, second, seen, known)
        return self.compare(first, second)
