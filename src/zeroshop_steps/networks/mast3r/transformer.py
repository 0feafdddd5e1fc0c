"""The blocks of the transformers: attention that knows where in the image a token is (2D rotary embedding), and MLPs."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from zeroshop_steps.networks.layers import NORM_EPSILON, Mlp

# Of the published network.
MLP_RATIO = 4

RotaryFactors = tuple[Tensor, Tensor]
"""Cosines and sines, each (tokens, 2, head_dim / 4): of a token's row for the first half of a head, of its column for the second."""


def compute_rotary_factors(rows: int, columns: int, head_dim: int, device: torch.device | str = "cpu") -> RotaryFactors:
    """How far each channel of each token of a (rows, columns) grid, in row-major order, is turned.

    RoFormer, equation 15, for each image axis with half of the channels (CroCo v2, section 3.2), and 100 in place of 10,000.
    """
    quarter = head_dim // 4
    frequency = 100.0 ** -(torch.arange(quarter, device=device, dtype=torch.float32) / quarter)
    row, column = torch.meshgrid(torch.arange(rows, device=device), torch.arange(columns, device=device), indexing="ij")
    angle = torch.stack([row.reshape(-1), column.reshape(-1)], dim=1)[:, :, None] * frequency
    return angle.cos(), angle.sin()


def rotate(heads: Tensor, rotation: RotaryFactors) -> Tensor:
    """Turn (..., tokens, head_dim) queries or keys; channel i of an image axis is paired with channel i + head_dim / 4."""
    cosine, sine = (part.to(heads.dtype) for part in rotation)
    first, second = heads.unflatten(-1, (2, 2, heads.shape[-1] // 4)).unbind(-2)
    return torch.stack([first * cosine - second * sine, second * cosine + first * sine], dim=-2).flatten(-3)


def _split(x: Tensor, heads: int) -> Tensor:
    """(B, N, C) to (B, heads, N, C / heads)."""
    return x.unflatten(-1, (heads, -1)).transpose(1, 2)


def _attend(query: Tensor, key: Tensor, value: Tensor) -> Tensor:
    """Attention of (B, heads, N, D) by PyTorch's fused kernels, joined to (B, N, heads * D)."""
    return F.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)


class SelfAttention(nn.Module):
    """Attention within one image."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor, rotation: RotaryFactors) -> Tensor:
        query, key, value = (_split(part, self.heads) for part in self.qkv(x).chunk(3, dim=-1))
        return self.proj(_attend(rotate(query, rotation), rotate(key, rotation), value))


class CrossAttention(nn.Module):
    """Attention from one image to the other."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.projq, self.projk, self.projv, self.proj = (nn.Linear(channels, channels) for _ in range(4))

    def forward(self, x: Tensor, other: Tensor, rotation: RotaryFactors, other_rotation: RotaryFactors) -> Tensor:
        query = rotate(_split(self.projq(x), self.heads), rotation)
        key = rotate(_split(self.projk(other), self.heads), other_rotation)
        return self.proj(_attend(query, key, _split(self.projv(other), self.heads)))


class EncoderBlock(nn.Module):
    """Self-attention and MLP, each with a norm before and added to what came in."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.attn = SelfAttention(channels, heads)
        self.norm2 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.mlp = Mlp(channels, MLP_RATIO * channels, channels)

    def forward(self, x: Tensor, rotation: RotaryFactors) -> Tensor:
        x = x + self.attn(self.norm1(x), rotation)
        return x + self.mlp(self.norm2(x))


class DecoderBlock(nn.Module):
    """Self-attention, attention to the other image, and MLP."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.attn = SelfAttention(channels, heads)
        self.cross_attn = CrossAttention(channels, heads)
        self.norm2 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.norm3 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.mlp = Mlp(channels, MLP_RATIO * channels, channels)
        self.norm_y = nn.LayerNorm(channels, eps=NORM_EPSILON)

    def forward(self, x: Tensor, other: Tensor, rotation: RotaryFactors, other_rotation: RotaryFactors) -> Tensor:
        x = x + self.attn(self.norm1(x), rotation)
        x = x + self.cross_attn(self.norm2(x), self.norm_y(other), rotation, other_rotation)
        return x + self.mlp(self.norm3(x))
