"""The whole network: images in; cameras, depth and rays out."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.da3.backbone import Backbone, Da3Tokens
from zeroshop_steps.networks.da3.camera_tokens import CameraDecoder, CameraEncoder
from zeroshop_steps.networks.da3.dual_head import DualHead
from zeroshop_steps.networks.da3.settings import SMALL, Da3Settings

PREFIX = "model."  # of the names in the published files


@dataclass(frozen=True)
class Da3Prediction:
    """What one pass says about S images of H x W pixels. The world is the reference camera's frame; its unit is arbitrary.

    Attributes:
        encodings: (S, 9) cameras: translation and quaternion (x, y, z, w) of world_from_camera, vertical and horizontal field of
            view in radians.
        depth: (S, H, W) along the optical axis, and `depth_confidence`, at least 1.
        rays: (S, 8 rows, 8 columns, 6) direction and origin of each ray, and `ray_confidence`, at least 1; None where not asked for.
    """

    encodings: Tensor
    depth: Tensor
    depth_confidence: Tensor
    rays: Tensor | None
    ray_confidence: Tensor | None


class DepthAnything3(nn.Module):
    """Depth Anything 3; parameters have the names and shapes of the published checkpoints, less `PREFIX`."""

    def __init__(self, settings: Da3Settings = SMALL) -> None:
        super().__init__()
        self.settings = settings
        self.backbone = Backbone(settings)
        self.head = DualHead(settings)
        self.cam_dec = CameraDecoder(settings)
        self.cam_enc = CameraEncoder(settings)

    def forward(
        self,
        images: Tensor,
        known: Tensor | None = None,
        rays: bool = True,
        precision: torch.dtype = torch.float32,
        chunk: int = 8,
    ) -> Da3Prediction:
        """Predict.

        Args:
            images: (S, 3, H, W) sRGB in 0 to 1; H and W are multiples of the patch.
            known: (S, 9) encodings of cameras that are known, in the frame of the first and at a median distance of 1 from it.
            rays: whether the rays are made, too.
            precision: of the backbone; the heads always calculate in the images' own.
            chunk: images at a time in the head.
        """
        size_px = (images.shape[2], images.shape[3])
        tokens = self.tokens(images, precision, None if known is None else self.cam_enc(known))
        encodings, depth, confidence = self.cameras_and_depth(tokens, size_px, chunk)
        values = self.head.rays(tokens.layers, size_px).movedim(1, 3) if rays else None
        parts = (None, None) if values is None else (values[..., :6], 1 + values[..., 6].exp())
        return Da3Prediction(encodings, depth, confidence, *parts)

    def tokens(
        self, images: Tensor, precision: torch.dtype, cameras: Tensor | None = None, after_block: Callable[[], None] = lambda: None
    ) -> Da3Tokens:
        """What the heads read, of (S, 3, H, W) images; calculated in `precision`, returned in the images' own."""
        with torch.autocast(images.device.type, precision, enabled=precision != images.dtype):
            tokens = self.backbone(images, cameras, after_block)
        return Da3Tokens([layer.to(images.dtype) for layer in tokens.layers], tokens.camera.to(images.dtype))

    def cameras_and_depth(
        self, tokens: Da3Tokens, size_px: tuple[int, int], chunk: int, after_chunk: Callable[[], None] = lambda: None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """(S, 9) encodings, (S, H, W) depth and (S, H, W) confidence, from `tokens` of images of `size_px` (H, W)."""
        depth, confidence = self.head(tokens.layers, size_px, chunk, after_chunk).unbind(1)
        return self.cam_dec(tokens.camera), depth.exp(), 1 + confidence.exp()


def adapt_names(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The published tensors under the network's own names."""
    return {name.removeprefix(PREFIX): tensor for name, tensor in state.items()}
