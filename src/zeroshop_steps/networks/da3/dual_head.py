"""A dense prediction transformer with two outputs: depth, and the ray of each pixel (Depth Anything 3, section 3)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zeroshop_steps.networks.da3.settings import Da3Settings
from zeroshop_steps.networks.vggt.dpt_head import SCRATCH_HIDDEN, DptHead, FeatureFusion, ResidualUnit, Scratch, fuse_maps

RAY_VALUES = 7  # direction and origin in the world, and a confidence


class PlainUnit(ResidualUnit):
    """Two convolutions beside a shortcut of what came in."""

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


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
