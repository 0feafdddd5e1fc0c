"""DINOv2 in which the later blocks attend within an image and across all images by turns (Depth Anything 3, section 3)."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.da3.settings import Da3Settings
from zeroshop_steps.networks.layers import NORM_EPSILON, Block, Patches, Rotation
from zeroshop_steps.networks.vggt.aggregator import normalise_colors


@dataclass(frozen=True)
class Da3Tokens:
    """What the heads read of S images.

    Attributes:
        layers: four of (S, patches, 2 x width): what the last block within the image made of them, then, normalised, what the
            block across all images did.
        camera: (S, 2 x width) camera tokens of the last of these, without the norm.
    """

    layers: list[Tensor]
    camera: Tensor


class VisionTransformer(nn.Module):
    """From images to tokens. The world is seen from the reference image, which is chosen by what the first blocks say."""

    def __init__(self, settings: Da3Settings) -> None:
        super().__init__()
        width, self.settings = settings.width, settings
        self.patch_embed = Patches(settings.patch_px, width)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, width))
        self.camera_token = nn.Parameter(torch.zeros(1, 2, width))  # of the reference, of the others
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + settings.grid**2, width))
        self.blocks = nn.ModuleList(
            Block(width, settings.heads, index >= settings.alone, eps=NORM_EPSILON) for index in range(settings.depth)
        )
        self.norm = nn.LayerNorm(width)

    def forward(self, images: Tensor, cameras: Tensor | None = None, after_block: Callable[[], None] = lambda: None) -> Da3Tokens:
        """The tokens after the blocks `settings.layers`.

        Args:
            images: (S, 3, H, W) sRGB in 0 to 1; H and W are multiples of the patch.
            cameras: (S, width) tokens of known cameras, of which the first is the reference; None where they are not known.
            after_block: called after every block, for a progress bar.
        """
        frames, rows, columns = len(images), *(side // self.settings.patch_px for side in images.shape[2:])
        tokens = torch.cat([self.cls_token.expand(frames, -1, -1), self.patch_embed(normalise_colors(images))], dim=1)
        tokens = tokens + self._positions(rows, columns)
        within, across = self._rotations(frames, rows, columns, images.device)
        order = torch.arange(frames, device=images.device)
        kept, alone = [], tokens
        for index, block in enumerate(self.blocks):
            if index == self.settings.alone - 1 and cameras is None and frames >= self.settings.chosen_from:
                first = choose_reference(tokens[:, 0])
                order = torch.cat([first[None], order[order != first]])
                tokens = tokens[order]
            if index == self.settings.alone:
                if cameras is None:
                    cameras = self.camera_token[0, [0] + [1] * (frames - 1)]
                tokens = torch.cat([cameras[:, None].to(tokens.dtype), tokens[:, 1:]], dim=1)
            if index >= self.settings.alone and index % 2 == 1:
                tokens = block(tokens.flatten(0, 1)[None], across)[0].unflatten(0, (frames, -1))
            else:
                tokens = alone = block(tokens, within if index >= self.settings.alone else None)
            if index in self.settings.layers:
                kept.append((alone, tokens))
            after_block()
        back = order.argsort()
        layers = [torch.cat([alone[:, 1:], self.norm(tokens[:, 1:])], dim=2)[back] for alone, tokens in kept]
        return Da3Tokens(layers, torch.cat([part[:, 0] for part in kept[-1]], dim=1)[back])

    def _positions(self, rows: int, columns: int) -> Tensor:
        """(1, 1 + rows x columns, width) positions, resampled where the image is not the square that was trained on."""
        grid = self.settings.grid
        if (rows, columns) == (grid, grid):
            return self.pos_embed
        square = self.pos_embed[:, 1:].unflatten(1, (grid, grid)).permute(0, 3, 1, 2)
        scale = (rows + self.settings.grid_offset) / grid, (columns + self.settings.grid_offset) / grid
        resized = F.interpolate(square.float(), scale_factor=scale, mode="bicubic").to(square.dtype)
        return torch.cat([self.pos_embed[:, :1], resized.flatten(2).transpose(1, 2)], dim=1)

    def _rotations(self, frames: int, rows: int, columns: int, device: torch.device) -> tuple[Rotation, Rotation]:
        """Of one image's tokens, which stand where their patches are, and of all images', whose patches all stand at (1, 1)."""
        places = torch.cartesian_prod(torch.arange(1, rows + 1, device=device), torch.arange(1, columns + 1, device=device))
        camera = torch.zeros(1, 2, dtype=places.dtype, device=device)
        width = self.settings.width // self.settings.heads
        within = Rotation.of(torch.cat([camera, places]), width)
        across = Rotation.of(torch.cat([camera, torch.ones_like(places)]), width)
        return within, across.tiled(frames)


class Backbone(nn.Module):
    """The transformer under the name that checkpoints use."""

    def __init__(self, settings: Da3Settings) -> None:
        super().__init__()
        self.pretrained = VisionTransformer(settings)

    def forward(self, images: Tensor, cameras: Tensor | None = None, after_block: Callable[[], None] = lambda: None) -> Da3Tokens:
        return self.pretrained(images, cameras, after_block)


def choose_reference(tokens: Tensor) -> Tensor:
    """The number of the image that is the least extreme, by (S, width) class tokens.

    Three measures count, each from the least to the most of all images: the likeness to the others, the length of the token, and the
    variance of its direction. The image nearest to the middle of all three is taken.
    """
    length = tokens.norm(dim=1)
    direction = tokens / length[:, None]
    likeness = (direction @ direction.T).sum(1) - 1
    measures = torch.stack([likeness / (len(tokens) - 1), length, direction.var(dim=1)])
    least, most = measures.amin(1, keepdim=True), measures.amax(1, keepdim=True)
    return ((measures - least) / (most - least + 1e-8) - 0.5).abs().sum(0).argmin()
