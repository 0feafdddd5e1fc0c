"""The whole network: images in; cameras, depth and rays out."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.da3.backbone import Backbone, Da3Tokens
from zeroshop_steps.networks.da3.camera_tokens import CameraDecoder, CameraEncoder
from zeroshop_steps.networks.da3.settings import SMALL, Da3Settings
from zeroshop_steps.networks.layers import FeatureFusion, PlainUnit
from zeroshop_steps.networks.vggt.dpt_head import SCRATCH_HIDDEN, DptHead, Scratch, fuse_maps

RAY_VALUES = 7  # direction and origin in the world, and a confidence
PREFIX = "model."  # of the names in the published files


class RayOutput(nn.ModuleDict):
    """From a map's features to its rays. The norm between is given: all maps have the same."""

    def __init__(self, width: int) -> None:
        super().__init__({"0": nn.Conv2d(width, SCRATCH_HIDDEN, 3, padding=1), "5": nn.Conv2d(SCRATCH_HIDDEN, RAY_VALUES, 1)})

    def forward(self, features: Tensor, norm: nn.Module) -> Tensor:
        return self["5"](F.relu(norm(self["0"](features).movedim(1, 3)).movedim(3, 1)))


class DualScratch(Scratch):
    """The convolutions of the depth, and of the rays beside them, from the same four maps.

    Of the four outputs of the rays, only the finest is made; the others are here because checkpoints hold them. They share one norm,
    which checkpoints hold with the first.
    """

    def __init__(self, channels: tuple[int, ...], features: int) -> None:
        super().__init__(channels, features, 2)
        for level in range(1, len(channels) + 1):
            for name in (f"refinenet{level}", f"refinenet{level}_aux"):
                setattr(self, name, FeatureFusion(features, level == len(channels), PlainUnit))
        half = features // 2
        sides = (features, half, features, half, features, half)
        self.output_conv1_aux = nn.ModuleList(
            nn.Sequential(*(nn.Conv2d(sides[index], sides[index + 1], 3, padding=1) for index in range(5))) for _ in channels
        )
        outputs = [RayOutput(half) for _ in channels]
        outputs[0]["2"] = nn.LayerNorm(SCRATCH_HIDDEN)
        self.output_conv2_aux = nn.ModuleList(outputs)

    def ray_features(self, maps: list[Tensor]) -> Tensor:
        """Fuse four maps, finest first, to one of twice the finest's size."""
        lateral = [getattr(self, f"layer{level}_rn")(values) for level, values in enumerate(maps, start=1)]
        fused = fuse_maps(lateral, [getattr(self, f"refinenet{level}_aux") for level in range(1, len(maps) + 1)])
        return self.output_conv1_aux[-1](fused)

    def ray_values(self, features: Tensor) -> Tensor:
        """What the rays are in a map of features."""
        return self.output_conv2_aux[-1](features, self.output_conv2_aux[0].get_submodule("2"))


class DualHead(DptHead):
    """From tokens to (S, 2, H, W) logarithms of depth and of confidence - 1, as `DptHead` does it, and to rays."""

    scratch: DualScratch

    def __init__(self, settings: Da3Settings) -> None:
        super().__init__(2 * settings.width, settings.patch_px, settings.dense_features, settings.dense_channels, 2)
        self.scratch = DualScratch(settings.dense_channels, settings.dense_features)

    def rays(self, layers: list[Tensor], size_px: tuple[int, int]) -> Tensor:
        """(S, 7, 8 rows, 8 columns) values on a grid eight times as fine as the patches: ray, and logarithm of confidence - 1.

        The ray of a pixel is its direction in the world, of the length that it has at depth 1, and the camera's centre.
        """
        maps = []
        for frame in range(len(layers[0])):
            features = self.scratch.ray_features(self._levels([tokens[frame : frame + 1] for tokens in layers], size_px))
            maps.append(self.scratch.ray_values(self._placed(features, size_px[1] / size_px[0])))
        return torch.cat(maps)


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
