"""Which points of two clouds belong together: few of each first, then many."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.sam6d.embedding import SurroundingsEmbedding
from zeroshop_steps.networks.sam6d.points import take
from zeroshop_steps.networks.sam6d.settings import Sam6dSettings

TINY = 1e-6


class PointAttention(nn.Module):
    """Scaled dot products by PyTorch's fused kernels; with positions, those of queries and embedded pairs are added."""

    def __init__(self, settings: Sam6dSettings, with_pairs: bool) -> None:
        super().__init__()
        self.heads, channels = settings.heads, settings.channels
        self.proj_q = nn.Linear(channels, channels)
        self.proj_k = nn.Linear(channels, channels)
        self.proj_v = nn.Linear(channels, channels)
        self.proj_p = nn.Linear(channels, channels) if with_pairs else None

    def forward(self, points: Tensor, others: Tensor, pairs: Tensor | None) -> Tensor:
        """(B, N, C) points look at (B, M, C) others; pairs are (B, N, M, C)."""
        queries, keys, values = (
            project(part).unflatten(2, (self.heads, -1)).transpose(1, 2)
            for project, part in ((self.proj_q, points), (self.proj_k, others), (self.proj_v, others))
        )
        bias = None
        if self.proj_p is not None and pairs is not None:
            # q . (W e + b) is taken as (q W) . e: to project N queries is far less work than N x M pairs, and q . b, which is the same for
            # all that a point looks at, falls out of the softmax.
            weight = self.proj_p.weight.unflatten(0, (self.heads, -1))
            turned = torch.einsum("bhnd,hdc->bnhc", queries, weight)
            scores = (turned @ pairs.transpose(2, 3)).transpose(1, 2)
            bias = scores / queries.shape[3] ** 0.5
        return F.scaled_dot_product_attention(queries, keys, values, attn_mask=bias).transpose(1, 2).flatten(2)


class LinearAttention(nn.Module):
    """Attention whose kernel is a product of features (FLatten Transformer), so that its cost grows with N + M."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.heads, channels = settings.heads, settings.channels
        self.proj_q = nn.Linear(channels, channels)
        self.proj_k = nn.Linear(channels, channels)
        self.proj_v = nn.Linear(channels, channels)
        self.scale = nn.Parameter(torch.zeros(1, 1, channels))

    def forward(self, points: Tensor, others: Tensor, _: Tensor | None = None) -> Tensor:
        """(B, N, C) points look at (B, M, C) others."""
        queries, keys = self._focus(self.proj_q(points)), self._focus(self.proj_k(others))
        values = self.proj_v(others).unflatten(2, (self.heads, -1)).transpose(1, 2)
        shares = 1 / (queries @ keys.sum(2)[..., None] + TINY)
        return (queries @ (keys.transpose(2, 3) @ values) * shares).transpose(1, 2).flatten(2)

    def _focus(self, values: Tensor) -> Tensor:
        """(B, heads, N, C / heads): positive, and sharpened without a change of length."""
        values = (F.relu(values) + TINY) / F.softplus(self.scale)
        # A power makes linear attention as selective as a softmax.
        sharp = values**3
        sharp = sharp / sharp.norm(dim=-1, keepdim=True) * values.norm(dim=-1, keepdim=True)
        return sharp.unflatten(2, (self.heads, -1)).transpose(1, 2)


class AttentionLayer(nn.Module):
    """Attention, added to what was there."""

    def __init__(self, channels: int, attention: nn.Module) -> None:
        super().__init__()
        self.attention = attention
        self.linear = nn.Linear(channels, channels)
        self.norm = nn.LayerNorm(channels)

    def forward(self, points: Tensor, others: Tensor, pairs: Tensor | None) -> Tensor:
        return self.norm(self.linear(self.attention(points, others, pairs)) + points)


class PointwiseLayer(nn.Module):
    """An MLP of each point, added to what was there."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.expand = nn.Linear(channels, 2 * channels)
        self.squeeze = nn.Linear(2 * channels, channels)
        self.norm = nn.LayerNorm(channels)

    def forward(self, points: Tensor) -> Tensor:
        return self.norm(points + self.squeeze(F.relu(self.expand(points))))


class TransformerLayer(nn.Module):
    """Attention, then an MLP."""

    def __init__(self, channels: int, attention: nn.Module) -> None:
        super().__init__()
        self.attention = AttentionLayer(channels, attention)
        self.output = PointwiseLayer(channels)

    def forward(self, points: Tensor, others: Tensor, pairs: Tensor | None = None) -> Tensor:
        return self.output(self.attention(points, others, pairs))


class GeometricTransformer(nn.Module):
    """Two clouds: each looks at itself, knowing its geometry, then the first at the second, then the second at the first."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        attentions = (PointAttention(settings, with_pairs) for with_pairs in (True, False))
        self.layers = nn.ModuleList([TransformerLayer(settings.channels, attention) for attention in attentions])

    def forward(self, first: Tensor, first_pairs: Tensor, second: Tensor, second_pairs: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, C) and (B, M, C) points, (B, N, N, C) and (B, M, M, C) pairs."""
        alone, across = self.layers
        first, second = alone(first, first, first_pairs), alone(second, second, second_pairs)
        first = across(first, second)
        return first, across(second, first)


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
        self.temperature = settings.temperature
        self.in_proj = nn.Linear(settings.features, settings.channels)
        self.out_proj = nn.Linear(settings.channels, settings.features)
        self.bg_token = nn.Parameter(torch.zeros(1, 1, settings.channels))

    def add_none(self, features: Tensor) -> Tensor:
        """(B, 1 + N, C) of (B, N, C)."""
        return torch.cat([self.bg_token.expand(len(features), -1, -1), features], 1)

    def compare(self, first: Tensor, second: Tensor) -> Tensor:
        """(B, N, M) logits: cosines of what comes out, over the temperature."""
        first, second = (F.normalize(self.out_proj(features), dim=2) for features in (first, second))
        return first @ second.transpose(1, 2) / self.temperature


class CoarseMatching(PointMatching):
    """Sparse points of an image against those of an object."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__(settings)
        self.transformers = nn.ModuleList(GeometricTransformer(settings) for _ in range(settings.blocks))

    def forward(self, seen: SparseCloud, known: SparseCloud) -> Tensor:
        """(B, 1 + S, 1 + S) logits; the first row and column stand for none."""
        first, second = (self.add_none(self.in_proj(cloud.features)) for cloud in (seen, known))
        for transformer in self.transformers:
            first, second = transformer(first, seen.pairs, second, known.pairs)
        return self.compare(first, second)


class SparseToDense(nn.Module):
    """Sparse points look at each other, and then all points of a cloud at its own sparse ones."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.sparse_layer = GeometricTransformer(settings)
        self.dense_layer = TransformerLayer(settings.channels, LinearAttention(settings))

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
        self.transformers = nn.ModuleList(SparseToDense(settings) for _ in range(settings.blocks))

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
