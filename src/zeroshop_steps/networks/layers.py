"""What the networks have in common, under the names that their checkpoints use: transformer blocks, and the units of decoders of maps."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

NORM_EPSILON = 1e-6  # of the layer norms of vision transformers
ROPE_BASE = 100.0  # of rotary positions: the slowest frequency is about its inverse (CroCo v2, section 3.2)


class Patches(nn.Module):
    """Each patch of (B, 3, H, W) images as one token, (B, patches, width)."""

    def __init__(self, patch_px: int, width: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, patch_px, patch_px)

    def forward(self, images: Tensor) -> Tensor:
        return self.proj(images).flatten(2).transpose(1, 2)


class Mlp(nn.Module):
    """Two linear layers with a GELU between."""

    def __init__(self, width: int, hidden: int, out: int | None = None) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, hidden)
        self.fc2 = nn.Linear(hidden, width if out is None else out)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(F.gelu(self.fc1(x)))


@dataclass(frozen=True)
class Rotation:
    """Rotary position embedding (Su et al. 2021) of a sequence, on two axes: the same for all blocks and heads.

    Attributes:
        cos, sin: (T, head width) factors of each token.
    """

    cos: Tensor
    sin: Tensor

    @staticmethod
    def of(positions: Tensor, width: int) -> "Rotation":
        """The rotation of tokens at (T, 2) row and column `positions`: the first half of a head turns with the row.

        Args:
            positions: whole numbers.
            width: of a head; a multiple of 4.
        """
        frequencies = ROPE_BASE ** -(torch.arange(0, width // 2, 2, device=positions.device).float() / (width // 2))
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

    def __init__(self, width: int, heads: int, normalised: bool = False) -> None:
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

    def __init__(self, width: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.gamma


class Block(nn.Module):
    """A pre-normalised transformer block over (B, T, width) tokens.

    Args:
        width: of a token.
        heads: of the attention.
        normalised: whether queries and keys are normalised.
        scaled: whether its branches have a LayerScale.
        eps: of the two norms.
    """

    def __init__(self, width: int, heads: int, normalised: bool = False, scaled: bool = True, eps: float = 1e-5) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=eps)
        self.attn = Attention(width, heads, normalised)
        self.ls1 = LayerScale(width) if scaled else nn.Identity()
        self.norm2 = nn.LayerNorm(width, eps=eps)
        self.mlp = Mlp(width, 4 * width)
        self.ls2 = LayerScale(width) if scaled else nn.Identity()

    def forward(self, x: Tensor, rotation: Rotation | None = None) -> Tensor:
        x = x + self.ls1(self.attn(self.norm1(x), rotation))
        return x + self.ls2(self.mlp(self.norm2(x)))


class ResidualUnit(nn.Module):
    """Two convolutions beside a shortcut that starts after the first activation, as the trained weights expect."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(features, features, 3, padding=1)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        x = F.relu(x)
        return x + self.conv2(F.relu(self.conv1(x)))


class PlainUnit(ResidualUnit):
    """The same, but for a shortcut that starts before the first activation."""

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class FeatureFusion(nn.Module):
    """Add a finer map to a coarser one and enlarge the sum; `unit` is what both go through.

    With `coarsest`, there is no unit for a finer map, which some checkpoints hold all the same.
    """

    def __init__(self, features: int, coarsest: bool, unit: type[ResidualUnit] = ResidualUnit) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(features, features, 1)
        if not coarsest:
            self.resConfUnit1 = unit(features)
        self.resConfUnit2 = unit(features)

    def forward(self, coarse: Tensor, fine: Tensor | None, size: tuple[int, int]) -> Tensor:
        summed = coarse if fine is None else coarse + self.resConfUnit1(fine)
        return self.out_conv(resize_map(self.resConfUnit2(summed), size))


def resize_map(values: Tensor, size: tuple[int, int]) -> Tensor:
    """(B, C, H, W) maps at another size, corner on corner."""
    return F.interpolate(values, size=size, mode="bilinear", align_corners=True)
