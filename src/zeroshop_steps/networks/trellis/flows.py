"""The two flows: which voxels hold surface, and what their latents are (rectified flow, Liu et al. 2023)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.trellis.layers import FlowBlock, TimeEmbedding, embed_positions, plain_norm
from zeroshop_steps.networks.trellis.settings import FlowSettings
from zeroshop_steps.networks.trellis.sparse import Pooling, SparseVoxels, SubmanifoldConvolution


class StructureFlow(nn.Module):
    """The velocity of a dense grid of latents, whose decoder says which voxels hold surface. Each of its places is a token."""

    def __init__(self, settings: FlowSettings) -> None:
        super().__init__()
        self.settings = settings
        places = torch.cartesian_prod(*[torch.arange(settings.resolution)] * 3)
        self.register_buffer("pos_emb", embed_positions(places, settings.width))
        self.t_embedder = TimeEmbedding(settings.width)
        self.input_layer = nn.Linear(settings.channels, settings.width)
        self.blocks = nn.ModuleList(FlowBlock(settings.width, settings.condition_width, settings.heads) for _ in range(settings.blocks))
        self.out_layer = nn.Linear(settings.width, settings.channels)

    def forward(self, x: Tensor, time: Tensor, condition: Tensor) -> Tensor:
        """The velocity.

        Args:
            x: (resolution^3, channels), the last axis fastest.
            time: scalar, 1000 at the noise and 0 at the data.
            condition: (T, condition width) image tokens.
        """
        tokens = self.input_layer(x) + self.pos_emb
        embedded = self.t_embedder(time)
        for block in self.blocks:
            tokens = block(tokens, embedded, condition)
        with torch.autocast(tokens.device.type, enabled=False):
            return self.out_layer(F.layer_norm(tokens.float(), tokens.shape[-1:]))


class ResidualBlock(nn.Module):
    """Two sparse convolutions beside a shortcut, modulated by the time."""

    def __init__(self, channels: int, out_channels: int, time_width: int) -> None:
        super().__init__()
        self.norm1 = plain_norm(channels, affine=True)
        self.norm2 = plain_norm(out_channels)
        self.conv1 = SubmanifoldConvolution(channels, out_channels)
        self.conv2 = SubmanifoldConvolution(out_channels, out_channels)
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(time_width, 2 * out_channels))
        self.skip_connection = nn.Linear(channels, out_channels) if channels != out_channels else nn.Identity()

    def forward(self, x: Tensor, voxels: SparseVoxels, time: Tensor) -> Tensor:
        scale, shift = self.emb_layers(time).chunk(2, dim=1)
        hidden = self.conv1(F.silu(self.norm1(x)), voxels)
        hidden = self.conv2(F.silu(self.norm2(hidden) * (1 + scale) + shift), voxels)
        return hidden + self.skip_connection(x)


class LatentFlow(nn.Module):
    """The velocity of the latents of sparse voxels; eight neighbours are one token."""

    def __init__(self, settings: FlowSettings) -> None:
        super().__init__()
        assert settings.io_channels is not None
        self.settings = settings
        width, inner = settings.width, settings.io_channels
        self.t_embedder = TimeEmbedding(width)
        self.input_layer = nn.Linear(settings.channels, inner)
        self.input_blocks = nn.ModuleList([ResidualBlock(inner, inner, width), ResidualBlock(inner, width, width)])
        self.blocks = nn.ModuleList(FlowBlock(width, settings.condition_width, settings.heads) for _ in range(settings.blocks))
        self.out_blocks = nn.ModuleList([ResidualBlock(2 * width, inner, width), ResidualBlock(2 * inner, inner, width)])
        self.out_layer = nn.Linear(inner, settings.channels)

    def forward(self, x: Tensor, voxels: SparseVoxels, pooling: Pooling, time: Tensor, condition: Tensor) -> Tensor:
        """The velocity.

        Args:
            x: (N, channels) of the voxels.
            voxels: their places.
            pooling: of these voxels.
            time: scalar, 1000 at the noise and 0 at the data.
            condition: (T, condition width) image tokens.
        """
        embedded = self.t_embedder(time)
        first = self.input_blocks[0](self.input_layer(x), voxels, embedded)
        second = self.input_blocks[1](pooling.average(first), pooling.coarse, embedded)
        tokens = second + embed_positions(pooling.coarse.coordinates, self.settings.width)
        for block in self.blocks:
            tokens = block(tokens, embedded, condition)
        hidden = self.out_blocks[0](pooling.spread(torch.cat([tokens, second], 1)), voxels, embedded)
        hidden = self.out_blocks[1](torch.cat([hidden, first], 1), voxels, embedded)
        with torch.autocast(hidden.device.type, enabled=False):
            return self.out_layer(F.layer_norm(hidden.float(), hidden.shape[-1:]))
