"""The whole network: images in; cameras, depth, points and tracks out."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.vggt.aggregator import Aggregator
from zeroshop_steps.networks.vggt.camera_head import CameraHead
from zeroshop_steps.networks.vggt.dpt_head import DptHead
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.networks.vggt.track_head import TrackHead, Tracks


@dataclass(frozen=True)
class VggtPrediction:
    """What one pass says about S frames of H x W pixels. The world is the first camera's frame; its unit is arbitrary.

    Attributes:
        encodings: (S, 9) cameras: translation and quaternion (x, y, z, w) of camera_from_world, vertical and horizontal field of
            view in radians.
        depth: (S, H, W) along the optical axis, and `depth_confidence`, at least 1.
        points: (S, H, W, 3) in the world, and `point_confidence`, at least 1; None where not asked for.
        tracks: of the query points; None where there are none.
    """

    encodings: Tensor
    depth: Tensor
    depth_confidence: Tensor
    points: Tensor | None
    point_confidence: Tensor | None
    tracks: Tracks | None


class Vggt(nn.Module):
    """VGGT; parameters have the names and shapes of the published checkpoint."""

    def __init__(self, settings: VggtSettings | None = None) -> None:
        super().__init__()
        self.settings = settings = settings or VggtSettings()
        width, patch_px = 2 * settings.width, settings.patch_px
        self.aggregator = Aggregator(settings)
        self.camera_head = CameraHead(settings)
        self.point_head = DptHead(width, patch_px, settings.dense_features, settings.dense_channels, 4)
        self.depth_head = DptHead(width, patch_px, settings.dense_features, settings.dense_channels, 2)
        self.track_head = TrackHead(settings)

    def forward(
        self,
        images: Tensor,
        query_xy: Tensor | None = None,
        points: bool = True,
        precision: torch.dtype = torch.float32,
        chunk: int = 8,
        after_part: Callable[[], None] = lambda: None,
    ) -> VggtPrediction:
        """Predict.

        Args:
            images: (S, 3, H, W) sRGB in 0 to 1; H and W are multiples of the patch.
            query_xy: (N, 2) points of the first frame to track, pixel indices.
            points: whether the point head runs, too; depth and cameras give points as well.
            precision: of the aggregator; the heads always calculate in the images' own.
            chunk: frames at a time in the dense heads.
            after_part: called after every pair of blocks and every chunk, for a progress bar.
        """
        size_px = (images.shape[2], images.shape[3])
        layers = self.tokens(images, precision, after_part)
        encodings, depth, depth_confidence = self.cameras_and_depth(layers, size_px, chunk, after_part)
        point_map, point_confidence = None, None
        if points:
            values = self.point_head(layers, size_px, chunk, after_part)
            point_map = values[:, :3].permute(0, 2, 3, 1)
            point_map, point_confidence = point_map.sign() * point_map.abs().expm1(), 1 + values[:, 3].exp()
        tracks = None if query_xy is None else self.track_head(layers, size_px, query_xy, chunk)
        return VggtPrediction(encodings, depth, depth_confidence, point_map, point_confidence, tracks)

    def tokens(self, images: Tensor, precision: torch.dtype, after_block: Callable[[], None] = lambda: None) -> list[Tensor]:
        """What all heads read, of (S, 3, H, W) images; calculated in `precision`, returned in the images' own."""
        with torch.autocast(images.device.type, precision, enabled=precision != images.dtype):
            layers = self.aggregator(images, after_block)
        return [layer.to(images.dtype) for layer in layers]

    def cameras_and_depth(
        self, layers: list[Tensor], size_px: tuple[int, int], chunk: int, after_chunk: Callable[[], None] = lambda: None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """(S, 9) encodings, (S, H, W) depth and (S, H, W) confidence, from `tokens` of images of `size_px` (H, W)."""
        depth, confidence = self.depth_head(layers, size_px, chunk, after_chunk).unbind(1)
        return self.camera_head(layers[-1][:, 0]), depth.exp(), 1 + confidence.exp()


def list_matrices(network: Vggt) -> list[nn.Module]:
    """The linear layers of the aggregator: what autocast calculates in half the precision whichever they are held in."""
    return [part for part in network.aggregator.modules() if isinstance(part, nn.Linear | nn.Conv2d)]
