"""Parts of the transformers: embeddings of places and times, attention, and blocks. A token is a row of (T, width)."""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import NORM_EPSILON

LONGEST_PERIOD = 10000.0
TIME_FREQUENCIES = 256

Attend = Callable[[Tensor, Tensor, Tensor], Tensor]
"""From (T, heads, width) queries, keys and values to (T, heads, width) outputs."""


def embed_positions(positions: Tensor, width: int) -> Tensor:
    """(N, width) sines and cosines of (N, 3) places, axis by axis; what does not divide by six is left zero."""
    count = width // 6
    frequencies = LONGEST_PERIOD ** -(torch.arange(count, device=positions.device, dtype=torch.float32) / count)
    angles = positions.float()[:, :, None] * frequencies
    embedded = torch.cat([angles.sin(), angles.cos()], dim=2).flatten(1)
    return F.pad(embedded, (0, width - embedded.shape[1]))


class TimeEmbedding(nn.Module):
    """A time, of which 1000 is pure noise, as a vector."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(TIME_FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, time: Tensor) -> Tensor:
        half = TIME_FREQUENCIES // 2
        frequencies = torch.exp(-math.log(LONGEST_PERIOD) / half * torch.arange(half, device=time.device, dtype=torch.float32))
        angles = time.reshape(1, 1).float() * frequencies
        return self.mlp(torch.cat([angles.cos(), angles.sin()], dim=1))


class HeadNorm(nn.Module):
    """Root-mean-square normalisation of each head's (T, heads, width) features."""

    def __init__(self, heads: int, width: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(heads, width))

    def forward(self, x: Tensor) -> Tensor:
        return (F.normalize(x.float(), dim=-1) * self.gamma * self.gamma.shape[1] ** 0.5).to(x.dtype)


def attend_fully(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """Attention of all tokens to all."""
    q, k, v = (part.transpose(0, 1)[None] for part in (q, k, v))
    return F.scaled_dot_product_attention(q, k, v)[0].transpose(0, 1)


class SelfAttention(nn.Module):
    """Multi-head self-attention; queries and keys are normalised in the flows."""

    def __init__(self, width: int, heads: int, normalised: bool) -> None:
        super().__init__()
        self.heads = heads
        self.to_qkv = nn.Linear(width, 3 * width)
        if normalised:
            self.q_rms_norm = HeadNorm(heads, width // heads)
            self.k_rms_norm = HeadNorm(heads, width // heads)
        self.normalised = normalised
        self.to_out = nn.Linear(width, width)

    def forward(self, x: Tensor, attend: Attend = attend_fully) -> Tensor:
        q, k, v = self.to_qkv(x).unflatten(-1, (3, self.heads, -1)).unbind(1)
        if self.normalised:
            q, k = self.q_rms_norm(q), self.k_rms_norm(k)
        return self.to_out(attend(q, k, v).flatten(1))


class CrossAttention(nn.Module):
    """Attention of the tokens to those of the picture."""

    def __init__(self, width: int, context_width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q = nn.Linear(width, width)
        self.to_kv = nn.Linear(context_width, 2 * width)
        self.to_out = nn.Linear(width, width)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        q = self.to_q(x).unflatten(-1, (self.heads, -1))
        k, v = self.to_kv(context).unflatten(-1, (2, self.heads, -1)).unbind(1)
        return self.to_out(attend_fully(q, k, v).flatten(1))


class FeedForward(nn.Module):
    """Two linear layers with a GELU, in its approximation by tanh, between."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(approximate="tanh"), nn.Linear(4 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        return self.mlp(x)


def plain_norm(width: int, affine: bool = False) -> nn.LayerNorm:
    """A layer norm as the blocks have it."""
    return nn.LayerNorm(width, eps=NORM_EPSILON, elementwise_affine=affine)


class FlowBlock(nn.Module):
    """A transformer block of a flow: the time shifts, scales and gates its branches (adaptive layer norm, Peebles and Xie 2023)."""

    def __init__(self, width: int, context_width: int, heads: int) -> None:
        super().__init__()
        self.norm1 = plain_norm(width)
        self.norm2 = plain_norm(width, affine=True)
        self.norm3 = plain_norm(width)
        self.self_attn = SelfAttention(width, heads, normalised=True)
        self.cross_attn = CrossAttention(width, context_width, heads)
        self.mlp = FeedForward(width)
        self.adaLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(width, 6 * width))

    def forward(self, x: Tensor, time: Tensor, context: Tensor) -> Tensor:
        shift, scale, gate, mlp_shift, mlp_scale, mlp_gate = self.adaLN_modulation(time).chunk(6, dim=1)
        x = x + gate * self.self_attn(self.norm1(x) * (1 + scale) + shift)
        x = x + self.cross_attn(self.norm2(x), context)
        return x + mlp_gate * self.mlp(self.norm3(x) * (1 + mlp_scale) + mlp_shift)


class PlainBlock(nn.Module):
    """A pre-normalised transformer block whose tokens attend as `attend` says."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm1 = plain_norm(width)
        self.norm2 = plain_norm(width)
        self.attn = SelfAttention(width, heads, normalised=False)
        self.mlp = FeedForward(width)

    def forward(self, x: Tensor, attend: Attend) -> Tensor:
        x = x + self.attn(self.norm1(x), attend)
        return x + self.mlp(self.norm2(x))
