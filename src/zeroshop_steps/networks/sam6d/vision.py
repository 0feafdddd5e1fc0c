"""Features of the pixels of a crop: a vision transformer, of which four layers are brought to the size of the crop."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import NORM_EPSILON, Mlp
from zeroshop_steps.networks.sam6d.settings import GRID, IMAGE_PX, PATCH_PX, Sam6dSettings

FINER = 4  # each patch gives FINER x FINER features, which are then interpolated


class Attention(nn.Module):
    """Every token looks at every other."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        self.proj = nn.Linear(channels, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        queries, keys, values = self.qkv(tokens).unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        return self.proj(F.scaled_dot_product_attention(queries, keys, values).transpose(1, 2).flatten(2))


class Block(nn.Module):
    """Attention, then an MLP."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.attn = Attention(channels, heads)
        self.norm2 = nn.LayerNorm(channels, eps=NORM_EPSILON)
        self.mlp = Mlp(channels, 4 * channels)

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = tokens + self.attn(self.norm1(tokens))
        return tokens + self.mlp(self.norm2(tokens))


class Patches(nn.Module):
    """Each patch of an image as one token."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, channels, PATCH_PX, stride=PATCH_PX)

    def forward(self, images: Tensor) -> Tensor:
        return self.proj(images).flatten(2).transpose(1, 2)


class VisionTransformer(nn.Module):
    """The patch tokens after each quarter of the blocks."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        channels = settings.vision_channels
        self.patch_embed = Patches(channels)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, channels))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + GRID**2, channels))
        self.blocks = nn.ModuleList(Block(channels, settings.vision_heads) for _ in range(settings.vision_depth))
        self.norm = nn.LayerNorm(channels, eps=NORM_EPSILON)

    def forward(self, images: Tensor) -> list[Tensor]:
        """(B, 3, IMAGE_PX, IMAGE_PX) to four times (B, GRID^2, C), the first layer first."""
        tokens = torch.cat([self.cls_token.expand(len(images), -1, -1), self.patch_embed(images)], 1) + self.pos_embed
        quarter, layers = len(self.blocks) // 4, []
        for index, block in enumerate(self.blocks):
            tokens = block(tokens)
            if (len(self.blocks) - 1 - index) % quarter == 0 and len(self.blocks) - 1 - index < 4 * quarter:
                layers.append(self.norm(tokens)[:, 1:])
        return layers


class PixelFeatures(nn.Module):
    """A feature of each pixel."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.vit = VisionTransformer(settings)
        self.output_upscaling = nn.Linear(4 * settings.vision_channels, FINER**2 * settings.features)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, IMAGE_PX, IMAGE_PX) normalised crops to (B, C, IMAGE_PX, IMAGE_PX)."""
        cells = self.output_upscaling(torch.cat(self.vit(images), 2)).unflatten(2, (FINER, FINER, -1)).unflatten(1, (GRID, GRID))
        finer = cells.permute(0, 5, 1, 3, 2, 4).reshape(len(images), -1, GRID * FINER, GRID * FINER)
        return F.interpolate(finer, (IMAGE_PX, IMAGE_PX), mode="bilinear", align_corners=False)


class FeatureExtraction(nn.Module):
    """Features of chosen pixels; the checkpoint has the network of pixels below `rgb_net`."""

    def __init__(self, settings: Sam6dSettings) -> None:
        super().__init__()
        self.rgb_net = PixelFeatures(settings)

    def forward(self, images: Tensor, chosen: Tensor) -> Tensor:
        """(B, 3, IMAGE_PX, IMAGE_PX) crops and (B, N) indices of their pixels, row by row, to (B, N, C)."""
        features = self.rgb_net(images).flatten(2)
        return features.gather(2, chosen[:, None].expand(-1, features.shape[1], -1)).transpose(1, 2)
