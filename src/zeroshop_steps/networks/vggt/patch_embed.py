"""DINOv2 with registers (Oquab et al. 2023; Darcet et al. 2024), as the patch embedding."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import NORM_EPSILON
from zeroshop_steps.networks.vggt.layers import Block
from zeroshop_steps.networks.vggt.settings import VggtSettings


class Patches(nn.Module):
    """Each patch of an image as one token."""

    def __init__(self, patch_px: int, width: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, width, patch_px, patch_px)

    def forward(self, images: Tensor) -> Tensor:
        return self.proj(images).flatten(2).transpose(1, 2)


class PatchEmbed(nn.Module):
    """Vision transformer from (S, 3, H, W) normalised images to (S, patches, width) normalised patch tokens."""

    def __init__(self, settings: VggtSettings) -> None:
        super().__init__()
        width, self.grid, self.patch_px = settings.width, settings.image_px // settings.patch_px, settings.patch_px
        self.patch_embed = Patches(settings.patch_px, width)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, width))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + self.grid**2, width))
        self.register_tokens = nn.Parameter(torch.zeros(1, settings.registers, width))
        self.mask_token = nn.Parameter(torch.zeros(1, width))  # of the training; here only because checkpoints hold it
        self.blocks = nn.ModuleList(Block(width, settings.heads, False, 1.0, 1e-6) for _ in range(settings.embed_depth))
        self.norm = nn.LayerNorm(width, eps=NORM_EPSILON)

    def forward(self, images: Tensor) -> Tensor:
        positions = self._positions(images.shape[2] // self.patch_px, images.shape[3] // self.patch_px)
        patches = self.patch_embed(images) + positions[:, 1:]
        count, others = len(images), torch.cat([self.cls_token + positions[:, :1], self.register_tokens], dim=1)
        tokens = torch.cat([others.expand(count, -1, -1), patches], dim=1)
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)[:, others.shape[1] :]

    def _positions(self, rows: int, columns: int) -> Tensor:
        """(1, 1 + rows x columns, width) positions, resampled where the image is not the square that was trained on."""
        if (rows, columns) == (self.grid, self.grid):
            return self.pos_embed
        grid = self.pos_embed[:, 1:].unflatten(1, (self.grid, self.grid)).permute(0, 3, 1, 2)
        resized = F.interpolate(grid.float(), size=(rows, columns), mode="bicubic", antialias=True)
        return torch.cat([self.pos_embed[:, :1], resized.flatten(2).transpose(1, 2).to(grid.dtype)], dim=1)
