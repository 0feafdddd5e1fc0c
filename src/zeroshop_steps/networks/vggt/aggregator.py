"""Alternating attention: each frame for itself, then all frames together (VGGT, section 3.2)."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.networks.layers import NORM_EPSILON, Block, Patches, Rotation
from zeroshop_steps.networks.vggt.settings import VggtSettings


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
        self.blocks = nn.ModuleList(Block(width, settings.heads, eps=NORM_EPSILON) for _ in range(settings.embed_depth))
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


class Aggregator(nn.Module):
    """From images to the tokens that all heads read. The first frame is the one whose camera the world is seen from."""

    def __init__(self, settings: VggtSettings) -> None:
        super().__init__()
        width, heads, self.settings = settings.width, settings.heads, settings
        self.patch_embed = PatchEmbed(settings)
        self.frame_blocks = nn.ModuleList(Block(width, heads, normalised=True) for _ in range(settings.depth))
        self.global_blocks = nn.ModuleList(Block(width, heads, normalised=True) for _ in range(settings.depth))
        self.camera_token = nn.Parameter(torch.zeros(1, 2, 1, width))
        self.register_token = nn.Parameter(torch.zeros(1, 2, settings.registers, width))

    def forward(self, images: Tensor, after_block: Callable[[], None] = lambda: None) -> list[Tensor]:
        """The tokens after the pairs of blocks `settings.layers`.

        Args:
            images: (S, 3, H, W) sRGB in 0 to 1; H and W are multiples of the patch.
            after_block: called after every pair of blocks, for a progress bar.

        Returns:
            Four of (S, 1 + registers + patches, 2 x width): the camera's token, registers, patches; what the frame block
            made of them, then what the global block did.
        """
        frames = len(images)
        patches = self.patch_embed(normalise_colors(images))
        special = torch.cat([self.camera_token, self.register_token], dim=2)[0]  # of the first frame, of the others
        tokens = torch.cat([special[[0] + [1] * (frames - 1)], patches], dim=1)
        rotation = self._rotation(images.shape[2], images.shape[3], images.device)
        rotations = rotation.tiled(frames)
        kept = []
        for index, (frame_block, global_block) in enumerate(zip(self.frame_blocks, self.global_blocks, strict=True)):
            alone = frame_block(tokens, rotation)
            tokens = global_block(alone.flatten(0, 1)[None], rotations)[0].unflatten(0, (frames, -1))
            if index in self.settings.layers:
                kept.append(torch.cat([alone, tokens], dim=2))
            after_block()
        return kept

    def _rotation(self, height_px: int, width_px: int, device: torch.device) -> Rotation:
        """Of one frame's tokens: camera and registers stand at (0, 0), patches from (1, 1) on."""
        settings = self.settings
        rows, columns = (torch.arange(1, side // settings.patch_px + 1, device=device) for side in (height_px, width_px))
        special = torch.zeros(1 + settings.registers, 2, dtype=rows.dtype, device=device)
        positions = torch.cat([special, torch.cartesian_prod(rows, columns)])
        return Rotation.of(positions, settings.width // settings.heads)


def normalise_colors(images: Tensor) -> Tensor:
    """(S, 3, H, W) sRGB in 0 to 1, as DINOv2 wants it."""
    mean, std = (torch.tensor(values, device=images.device, dtype=images.dtype)[:, None, None] for values in (MEAN, DEVIATION))
    return (images - mean) / std
