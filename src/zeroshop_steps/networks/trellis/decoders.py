"""The decoders: from the dense latents to the voxels that hold surface, and from their latents to a fine grid's features."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.trellis.layers import PlainBlock, embed_positions
from zeroshop_steps.networks.trellis.settings import MeshDecoderSettings, StructureDecoderSettings
from zeroshop_steps.networks.trellis.sparse import SparseVoxels, SubmanifoldConvolution, WindowAttention, subdivide

GROUPS = 32
CUBE_FEATURES = 8 * (1 + 3 + 6) + 21
"""Of a fine voxel: distance, displacement, and colour with normal at each corner, and the 21 weights of FlexiCubes."""


class ChannelNorm(nn.LayerNorm):
    """A layer norm over the channels of (1, channels, x, y, z)."""

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.movedim(1, -1)).movedim(-1, 1)


class DenseResidualBlock(nn.Module):
    """Two convolutions beside a shortcut."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1 = ChannelNorm(channels)
        self.norm2 = ChannelNorm(channels)
        self.conv1 = nn.Conv3d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv3d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.silu(self.norm2(self.conv1(F.silu(self.norm1(x))))))


class DenseUpsampling(nn.Module):
    """Eight values a voxel by convolution, which become its eight halves."""

    def __init__(self, channels: int, out_channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv3d(channels, 8 * out_channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        halves = self.conv(x).unflatten(1, (-1, 2, 2, 2)).permute(0, 1, 5, 2, 6, 3, 7, 4)
        return halves.flatten(6, 7).flatten(4, 5).flatten(2, 3)


class StructureDecoder(nn.Module):
    """From (1, channels, R, R, R) latents to a logit for each voxel of a finer grid: above zero, it holds surface."""

    def __init__(self, settings: StructureDecoderSettings) -> None:
        super().__init__()
        widths = settings.channels
        self.input_layer = nn.Conv3d(settings.latent_channels, widths[0], 3, padding=1)
        self.middle_block = nn.Sequential(*(DenseResidualBlock(widths[0]) for _ in range(2)))
        blocks: list[nn.Module] = []
        for width, following in zip(widths, (*widths[1:], None), strict=True):
            blocks += [DenseResidualBlock(width), DenseResidualBlock(width)]
            if following is not None:
                blocks.append(DenseUpsampling(width, following))
        self.blocks = nn.ModuleList(blocks)
        self.out_layer = nn.Sequential(ChannelNorm(widths[-1]), nn.SiLU(), nn.Conv3d(widths[-1], 1, 3, padding=1))

    def forward(self, latents: Tensor) -> Tensor:
        x = self.middle_block(self.input_layer(latents))
        for block in self.blocks:
            x = block(x)
        with torch.autocast(x.device.type, enabled=False):
            return self.out_layer(x.float())


class VoxelGroupNorm(nn.GroupNorm):
    """A group norm over all (N, channels) voxels together."""

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.T[None])[0].T


class Subdivision(nn.Module):
    """Voxels into their eight halves, with two convolutions beside a shortcut."""

    def __init__(self, channels: int, out_channels: int) -> None:
        super().__init__()
        self.act_layers = nn.Sequential(VoxelGroupNorm(GROUPS, channels), nn.SiLU())
        self.out_layers = nn.Sequential(
            SubmanifoldConvolution(channels, out_channels),
            VoxelGroupNorm(GROUPS, out_channels),
            nn.SiLU(),
            SubmanifoldConvolution(out_channels, out_channels),
        )
        self.skip_connection = SubmanifoldConvolution(channels, out_channels, 1)

    def forward(self, x: Tensor, halves: SparseVoxels) -> Tensor:
        """(8 N, out channels) features of `halves`, from (N, channels) of the voxels."""
        first, norm, activation, last = self.out_layers
        hidden = first(self.act_layers(x).repeat_interleave(8, 0), halves)
        hidden = last(activation(norm(hidden)), halves)
        # The shortcut looks at one voxel at a time, so it comes before the copies.
        return hidden + self.skip_connection(x, halves).repeat_interleave(8, 0)


class MeshDecoder(nn.Module):
    """From the latents of sparse voxels to the features of voxels a quarter as large, which `flexible_surface` reads."""

    def __init__(self, settings: MeshDecoderSettings) -> None:
        super().__init__()
        self.settings = settings
        width = settings.width
        self.input_layer = nn.Linear(settings.latent_channels, width)
        self.blocks = nn.ModuleList(PlainBlock(width, settings.heads) for _ in range(settings.blocks))
        self.upsample = nn.ModuleList([Subdivision(width, width // 4), Subdivision(width // 4, width // 8)])
        self.out_layer = nn.Linear(width // 8, CUBE_FEATURES)

    def forward(self, latents: Tensor, voxels: SparseVoxels) -> tuple[Tensor, SparseVoxels]:
        """(64 N, CUBE_FEATURES) features and their voxels, from (N, channels) latents."""
        x = self.input_layer(latents) + embed_positions(voxels.coordinates, self.settings.width)
        window = self.settings.window
        attend = [WindowAttention(voxels.coordinates, window, shift) for shift in (0, window // 2)]
        for index, block in enumerate(self.blocks):
            x = block(x, attend[index % 2])
        for part in self.upsample:
            voxels = subdivide(voxels)
            x = part(x, voxels)
        with torch.autocast(x.device.type, enabled=False):
            return self.out_layer(x.float()), voxels


def find_surface_voxels(logits: Tensor) -> SparseVoxels:
    """The voxels whose logit, of (1, 1, R, R, R), is above zero."""
    return SparseVoxels(torch.argwhere(logits[0, 0] > 0))
