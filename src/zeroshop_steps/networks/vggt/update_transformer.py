"""The transformer that corrects tracks (CoTracker; Karaev et al. 2024): attention along each, and between them over virtual ones."""

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.layers import Mlp
from zeroshop_steps.networks.vggt.settings import VggtSettings


class TrackBlock(nn.Module):
    """Attention and MLP; the shortcuts start after the first norm, as the trained weights expect."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)
        self.attn = nn.MultiheadAttention(width, heads, batch_first=True)
        self.mlp = Mlp(width, 4 * width)

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm1(x)
        x = x + self.attn(x, x, x, need_weights=False)[0]
        return x + self.mlp(self.norm2(x))


class CrossBlock(nn.Module):
    """The same, with attention to other tokens."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width)
        self.norm_context = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)
        self.cross_attn = nn.MultiheadAttention(width, heads, batch_first=True)
        self.mlp = Mlp(width, 4 * width)

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        x, context = self.norm1(x), self.norm_context(context)
        x = x + self.cross_attn(x, context, context, need_weights=False)[0]
        return x + self.mlp(self.norm2(x))


class UpdateTransformer(nn.Module):
    """From (N, S, inputs) tokens of N tracks in S frames to (N, S, outputs) corrections."""

    def __init__(self, settings: VggtSettings, inputs: int, outputs: int) -> None:
        super().__init__()
        width, heads, depth = settings.track_width, settings.track_heads, settings.track_depth
        self.input_norm = nn.LayerNorm(inputs)
        self.input_transform = nn.Linear(inputs, width)
        self.output_norm = nn.LayerNorm(width)
        self.flow_head = nn.Linear(width, outputs)
        self.virual_tracks = nn.Parameter(torch.zeros(1, settings.virtual_tracks, 1, width))  # the checkpoint's spelling
        self.time_blocks = nn.ModuleList(TrackBlock(width, heads) for _ in range(depth))
        self.space_virtual_blocks = nn.ModuleList(TrackBlock(width, heads) for _ in range(depth))
        self.space_point2virtual_blocks = nn.ModuleList(CrossBlock(width, heads) for _ in range(depth))
        self.space_virtual2point_blocks = nn.ModuleList(CrossBlock(width, heads) for _ in range(depth))

    def forward(self, inputs: Tensor) -> Tensor:
        count, frames, _ = inputs.shape
        start = self.input_transform(self.input_norm(inputs))
        tokens = torch.cat([start, self.virual_tracks[0].expand(-1, frames, -1)])
        for along, among, to_virtual, to_points in zip(
            self.time_blocks,
            self.space_virtual_blocks,
            self.space_virtual2point_blocks,
            self.space_point2virtual_blocks,
            strict=True,
        ):
            points, virtual = along(tokens).transpose(0, 1).split([count, len(tokens) - count], dim=1)
            virtual = among(to_virtual(virtual, points))
            tokens = torch.cat([to_points(points, virtual), virtual], dim=1).transpose(0, 1)
        return self.flow_head(self.output_norm(tokens[:count] + start))
