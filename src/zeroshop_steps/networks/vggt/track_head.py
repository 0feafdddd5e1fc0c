"""Tracks of points of the first frame through all frames (VGGT, section 3.3, after CoTracker; Karaev et al. 2024)."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.layers import Mlp
from zeroshop_steps.networks.vggt.dpt_head import DptHead
from zeroshop_steps.networks.vggt.settings import VggtSettings

VOLUME_VALUES = 1 << 27  # correlations that are held at a time


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


@dataclass(frozen=True)
class Tracks:
    """Where N points of the first frame are in all S frames.

    Attributes:
        xy: (S, N, 2) pixel indices: the centre of the first pixel is at (0, 0).
        visibility: (S, N) from 0 to 1.
        confidence: (S, N) from 0 to 1.
    """

    xy: Tensor
    visibility: Tensor
    confidence: Tensor


class TrackHead(nn.Module):
    """Feature maps from the tokens, and the tracker on them."""

    def __init__(self, settings: VggtSettings) -> None:
        super().__init__()
        features = settings.track_features
        self.feature_extractor = DptHead(2 * settings.width, settings.patch_px, features, settings.track_channels, None)
        self.tracker = PointTracker(settings)

    def forward(self, layers: list[Tensor], size_px: tuple[int, int], xy: Tensor, chunk: int = 8) -> Tracks:
        """Track (N, 2) pixel indices `xy` of the first frame; the other arguments are those of `DptHead`."""
        return self.tracker(self.feature_extractor(layers, size_px, chunk), xy)


class PointTracker(nn.Module):
    """Corrects positions and features of all tracks in rounds, from what correlates with them nearby."""

    def __init__(self, settings: VggtSettings) -> None:
        super().__init__()
        features, self.settings = settings.track_features, settings
        self.inputs = 3 * features + 4
        self.corr_mlp = Mlp(settings.track_levels * (2 * settings.track_radius + 1) ** 2, settings.track_width, features)
        self.query_ref_token = nn.Parameter(torch.zeros(1, 2, self.inputs))
        self.updateformer = UpdateTransformer(settings, self.inputs, features + 2)
        self.fmap_norm = nn.LayerNorm(features)
        self.ffeat_norm = nn.GroupNorm(1, features)
        self.ffeat_updater = nn.Sequential(nn.Linear(features, features), nn.GELU())
        self.vis_predictor = nn.Sequential(nn.Linear(features, 1))
        self.conf_predictor = nn.Sequential(nn.Linear(features, 1))

    def forward(self, maps: Tensor, xy: Tensor, rounds: int = 4) -> Tracks:
        """Track (N, 2) points `xy` of the first of (S, features, H / 2, W / 2) `maps`."""
        frames, features, height, width = maps.shape
        maps = self.fmap_norm(maps.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        pyramid = [maps]
        for _ in range(self.settings.track_levels - 1):
            pyramid.append(F.avg_pool2d(pyramid[-1], 2))
        start = xy / self.settings.track_stride
        place = start[:, None].expand(-1, frames, -1)  # (N, S, 2)
        found = sample_maps(maps[:1], start[None, None])[0, :, 0].T[:, None].expand(-1, frames, -1)  # (N, S, features)
        context = encode_positions(start, (height, width), self.inputs)[:, None] + self.query_ref_token[0, [0] + [1] * (frames - 1)]
        for _ in range(rounds):
            nearby = self.corr_mlp(self._correlations(pyramid, found, place))
            motion = place - place[:, :1]
            scaled = motion / 518
            tokens = torch.cat([encode_motion(motion, features // 2), scaled, scaled, nearby, found], dim=2) + context
            change = self.updateformer(tokens)
            found = found + self.ffeat_updater(self.ffeat_norm(change[..., 2:].flatten(0, 1))).unflatten(0, found.shape[:2])
            place = torch.cat([start[:, None], (place + change[..., :2])[:, 1:]], dim=1)
        visible, sure = self.vis_predictor(found).sigmoid(), self.conf_predictor(found).sigmoid()
        return Tracks(self.settings.track_stride * place.transpose(0, 1), visible[..., 0].T, sure[..., 0].T)

    def _correlations(self, pyramid: list[Tensor], found: Tensor, place: Tensor) -> Tensor:
        """(N, S, levels x window) correlations of (N, S, C) features with the maps around (N, S, 2) places."""
        frames, features, height, width = pyramid[0].shape
        reach = torch.arange(-self.settings.track_radius, self.settings.track_radius + 1, device=place.device, dtype=place.dtype)
        # Columns outside, rows inside: the order that the weights of `corr_mlp` know.
        window = torch.stack(torch.meshgrid(reach, reach, indexing="ij"), dim=2)
        chunk = max(1, VOLUME_VALUES // (frames * height * width))
        rows = []
        for some, centres in zip(found.split(chunk), place.split(chunk), strict=True):
            values = []
            for level, maps in enumerate(pyramid):
                volume = torch.matmul(some.transpose(0, 1), maps.flatten(2)) / math.sqrt(features)  # (S, n, h w)
                at = (centres.transpose(0, 1) / 2**level).flatten(0, 1)[:, None, None] + window
                volume = volume.unflatten(2, maps.shape[2:]).flatten(0, 1)[:, None]
                values.append(sample_maps(volume, at, "zeros").flatten(1).unflatten(0, (frames, -1)))
            rows.append(torch.cat(values, dim=2).transpose(0, 1))
        return torch.cat(rows)


def sample_maps(maps: Tensor, xy: Tensor, padding: str = "border") -> Tensor:
    """(B, C, h, w) bilinear samples of (B, C, H, W) maps at (B, h, w, 2) pixel indices x, y."""
    last = torch.tensor([max(side - 1, 1) for side in (maps.shape[3], maps.shape[2])], device=xy.device, dtype=xy.dtype)
    return F.grid_sample(maps, xy * (2 / last) - 1, align_corners=True, padding_mode=padding)


def encode_motion(motion: Tensor, channels: int) -> Tensor:
    """(N, S, 2 x channels) alternating sines and cosines of x, then of y, of (N, S, 2) motions."""
    frequencies = torch.arange(0, channels, 2, device=motion.device, dtype=torch.float32) * (1000.0 / channels)
    angles = motion[..., None] * frequencies
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(2)


def encode_positions(xy: Tensor, size: tuple[int, int], channels: int) -> Tensor:
    """(N, channels) sines and cosines of x, then of y: known at whole pixels of an (H, W) map, interpolated between."""
    frequencies = 10_000.0 ** -(torch.arange(channels // 4, dtype=torch.float64) / (channels // 4))
    codes = []
    for values, count in ((xy[:, 0], size[1]), (xy[:, 1], size[0])):
        angles = torch.arange(count, dtype=torch.float64)[:, None] * frequencies
        table = torch.cat([angles.sin(), angles.cos()], dim=1).to(xy)
        values = values.clamp(0, count - 1)
        low = values.floor().long()
        high = (low + 1).clamp(max=count - 1)
        codes.append(torch.lerp(table[low], table[high], (values - low)[:, None]))
    return torch.cat(codes, dim=1)
