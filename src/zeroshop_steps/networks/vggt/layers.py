"""Transformer blocks: attention with optional query-key normalisation and rotary positions, LayerScale, MLP."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import Mlp

LAYER_SCALE = 0.01  # of a block's branches at the start of training; checkpoints have their own values


@dataclass(frozen=True)
class Rotation:
    """Rotary position embedding (Su et al. 2021) of a sequence, on two axes: the same for all blocks and heads.

    Attributes:
        cos, sin: (T, head width) factors of each token.
    """

    cos: Tensor
    sin: Tensor

    @staticmethod
    def of(positions: Tensor, width: int, base: float) -> "Rotation":
        """The rotation of tokens at (T, 2) row and column `positions`: the first half of a head turns with the row.

        Args:
            positions: whole numbers.
            width: of a head; a multiple of 4.
            base: the slowest of the width / 4 frequencies is about 1 / base.
        """
        frequencies = base ** -(torch.arange(0, width // 2, 2, device=positions.device).float() / (width // 2))
        angles = positions.float()[:, :, None] * frequencies  # (T, 2, width / 4)
        angles = torch.cat([angles, angles], dim=2).flatten(1)
        return Rotation(angles.cos(), angles.sin())

    def tiled(self, count: int) -> "Rotation":
        """The rotation of `count` such sequences, one after the other."""
        return Rotation(self.cos.repeat(count, 1), self.sin.repeat(count, 1))

    def __call__(self, features: Tensor) -> Tensor:
        """Turn (..., T, head width) features."""
        first, second = features.unflatten(-1, (2, 2, -1)).unbind(-2)
        turned = torch.stack([-second, first], dim=-2).flatten(-3)
        return features * self.cos + turned * self.sin


class Attention(nn.Module):
    """Multi-head self-attention (Vaswani et al. 2017)."""

    def __init__(self, width: int, heads: int, normalised: bool) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.q_norm = nn.LayerNorm(width // heads) if normalised else nn.Identity()
        self.k_norm = nn.LayerNorm(width // heads) if normalised else nn.Identity()
        self.proj = nn.Linear(width, width)

    def forward(self, x: Tensor, rotation: Rotation | None = None) -> Tensor:
        q, k, v = self.qkv(x).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        q, k = self.q_norm(q), self.k_norm(k)
        if rotation is not None:
            q, k = rotation(q), rotation(k)
        return self.proj(F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2))


class LayerScale(nn.Module):
    """A learned factor for each channel (Touvron et al. 2021)."""

    def __init__(self, width: int, start: float) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.full((width,), start))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.gamma


class Block(nn.Module):
    """A pre-normalised transformer block over (B, T, width) tokens.

    Args:
        width: of a token.
        heads: of the attention.
        normalised: whether queries and keys are normalised.
        scale: where LayerScale starts.
        eps: of the two norms.
    """

    def __init__(self, width: int, heads: int, normalised: bool, scale: float, eps: float = 1e-5) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=eps)
        self.attn = Attention(width, heads, normalised)
        self.ls1 = LayerScale(width, scale)
        self.norm2 = nn.LayerNorm(width, eps=eps)
        self.mlp = Mlp(width, 4 * width)
        self.ls2 = LayerScale(width, scale)

    def forward(self, x: Tensor, rotation: Rotation | None = None) -> Tensor:
        x = x + self.ls1(self.attn(self.norm1(x), rotation))
        return x + self.ls2(self.mlp(self.norm2(x)))
