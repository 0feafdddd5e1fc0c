"""Attention between points: with the geometry of pairs, without, and in linear time."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.sam6d.settings import HEADS

TINY = 1e-6


class PointAttention(nn.Module):
    """Scaled dot products by PyTorch's fused kernels; with positions, those of queries and embedded pairs are added."""

    def __init__(self, channels: int, with_pairs: bool) -> None:
        super().__init__()
        self.proj_q = nn.Linear(channels, channels)
        self.proj_k = nn.Linear(channels, channels)
        self.proj_v = nn.Linear(channels, channels)
        self.proj_p = nn.Linear(channels, channels) if with_pairs else None

    def forward(self, points: Tensor, others: Tensor, pairs: Tensor | None) -> Tensor:
        """(B, N, C) points look at (B, M, C) others; pairs are (B, N, M, C)."""
        queries, keys, values = (
            project(part).unflatten(2, (HEADS, -1)).transpose(1, 2)
            for project, part in ((self.proj_q, points), (self.proj_k, others), (self.proj_v, others))
        )
        bias = None
        if self.proj_p is not None and pairs is not None:
            # q . (W e + b) is taken as (q W) . e: to project N queries is far less work than N x M pairs, and q . b, which is the same for
            # all that a point looks at, falls out of the softmax.
            weight = self.proj_p.weight.unflatten(0, (HEADS, -1))
            turned = torch.einsum("bhnd,hdc->bnhc", queries, weight)
            scores = (turned @ pairs.transpose(2, 3)).transpose(1, 2)
            bias = scores / queries.shape[3] ** 0.5
        return F.scaled_dot_product_attention(queries, keys, values, attn_mask=bias).transpose(1, 2).flatten(2)


class LinearAttention(nn.Module):
    """Attention whose kernel is a product of features (FLatten Transformer), so that its cost grows with N + M."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.proj_q = nn.Linear(channels, channels)
        self.proj_k = nn.Linear(channels, channels)
        self.proj_v = nn.Linear(channels, channels)
        self.scale = nn.Parameter(torch.zeros(1, 1, channels))

    def forward(self, points: Tensor, others: Tensor, _: Tensor | None = None) -> Tensor:
        """(B, N, C) points look at (B, M, C) others."""
        queries, keys = self._focus(self.proj_q(points)), self._focus(self.proj_k(others))
        values = self.proj_v(others).unflatten(2, (HEADS, -1)).transpose(1, 2)
        shares = 1 / (queries @ keys.sum(2)[..., None] + TINY)
        return (queries @ (keys.transpose(2, 3) @ values) * shares).transpose(1, 2).flatten(2)

    def _focus(self, values: Tensor) -> Tensor:
        """(B, HEADS, N, C / HEADS): positive, and sharpened without a change of length."""
        values = (F.relu(values) + TINY) / F.softplus(self.scale)
        # A power makes linear attention as selective as a softmax.
        sharp = values**3
        sharp = sharp / sharp.norm(dim=-1, keepdim=True) * values.norm(dim=-1, keepdim=True)
        return sharp.unflatten(2, (HEADS, -1)).transpose(1, 2)


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

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList([TransformerLayer(channels, PointAttention(channels, with_pairs)) for with_pairs in (True, False)])

    def forward(self, first: Tensor, first_pairs: Tensor, second: Tensor, second_pairs: Tensor) -> tuple[Tensor, Tensor]:
        """(B, N, C) and (B, M, C) points, (B, N, N, C) and (B, M, M, C) pairs."""
        alone, across = self.layers
        first, second = alone(first, first, first_pairs), alone(second, second, second_pairs)
        first = across(first, second)
        return first, across(second, first)
