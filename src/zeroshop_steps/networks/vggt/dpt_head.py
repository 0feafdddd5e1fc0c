"""Dense prediction transformer (Ranftl et al. 2021): tokens of four depths become one map at the image's size."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from zeroshop_steps.networks.layers import FeatureFusion, resize_map

SCRATCH_HIDDEN = 32  # channels before the last convolution


class Scratch(nn.Module):
    """The convolutional part, under the names that checkpoints use."""

    def __init__(self, channels: tuple[int, ...], features: int, out: int | None) -> None:
        super().__init__()
        for level, count in enumerate(channels, start=1):
            setattr(self, f"layer{level}_rn", nn.Conv2d(count, features, 3, padding=1, bias=False))
            setattr(self, f"refinenet{level}", FeatureFusion(features, coarsest=level == len(channels)))
        self.output_conv1 = nn.Conv2d(features, features if out is None else features // 2, 3, padding=1)
        if out is not None:
            self.output_conv2 = nn.Sequential(
                nn.Conv2d(features // 2, SCRATCH_HIDDEN, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(SCRATCH_HIDDEN, out, 1)
            )

    def forward(self, maps: list[Tensor]) -> Tensor:
        """Fuse four maps, finest first, to one of twice the finest's size."""
        lateral = [getattr(self, f"layer{level}_rn")(values) for level, values in enumerate(maps, start=1)]
        return self.output_conv1(fuse_maps(lateral, [getattr(self, f"refinenet{level}") for level in range(1, len(maps) + 1)]))


class DptHead(nn.Module):
    """From the aggregator's tokens to a map for each frame.

    Args:
        width: of the tokens.
        patch_px: side of a patch.
        features, channels: of the convolutions; channels of the four inputs.
        out: channels of the map; None for the features themselves, at half the image's size and without positions.
    """

    def __init__(self, width: int, patch_px: int, features: int, channels: tuple[int, int, int, int], out: int | None) -> None:
        super().__init__()
        self.patch_px, self.dense = patch_px, out is not None
        self.norm = nn.LayerNorm(width)
        self.projects = nn.ModuleList(nn.Conv2d(width, count, 1) for count in channels)
        self.resize_layers = nn.ModuleList(
            (
                nn.ConvTranspose2d(channels[0], channels[0], 4, 4),
                nn.ConvTranspose2d(channels[1], channels[1], 2, 2),
                nn.Identity(),
                nn.Conv2d(channels[3], channels[3], 3, 2, 1),
            )
        )
        self.scratch = Scratch(channels, features, out)

    def forward(
        self, layers: list[Tensor], size_px: tuple[int, int], chunk: int = 8, after_chunk: Callable[[], None] = lambda: None
    ) -> Tensor:
        """(S, out, H, W) map, or (S, features, H / 2, W / 2) features; frames are independent, `chunk` of them go together.

        Args:
            layers: four of (S, special + patches, width) tokens.
            size_px: (H, W) of the images.
            chunk: frames at a time, which only memory and speed depend on.
            after_chunk: called after every chunk, for a progress bar.
        """
        maps = []
        for start in range(0, len(layers[0]), chunk):
            maps.append(self._frames([tokens[start : start + chunk] for tokens in layers], size_px))
            after_chunk()
        return torch.cat(maps)

    def _frames(self, layers: list[Tensor], size_px: tuple[int, int]) -> Tensor:
        shrink = 1 if self.dense else 2
        fused = resize_map(self.scratch(self._levels(layers, size_px)), (size_px[0] // shrink, size_px[1] // shrink))
        return self.scratch.output_conv2(self._placed(fused, size_px[1] / size_px[0])) if self.dense else fused

    def _levels(self, layers: list[Tensor], size_px: tuple[int, int]) -> list[Tensor]:
        """The tokens of each layer as a map, the first four times as fine as the patches, the last half as fine."""
        grid = size_px[0] // self.patch_px, size_px[1] // self.patch_px
        maps = []
        for tokens, project, resize in zip(layers, self.projects, self.resize_layers, strict=True):
            patches = self.norm(tokens[:, -grid[0] * grid[1] :]).transpose(1, 2).unflatten(2, grid)
            maps.append(resize(self._placed(project(patches), size_px[1] / size_px[0])))
        return maps

    def _placed(self, values: Tensor, aspect: float) -> Tensor:
        """Tell a map where its pixels are."""
        return (
            values + 0.1 * encode_positions((values.shape[2], values.shape[3]), values.shape[1], aspect).to(values)
            if self.dense
            else values
        )


def fuse_maps(lateral: list[Tensor], refine: Sequence[nn.Module]) -> Tensor:
    """Maps of equal channels, finest first, fused from the coarsest on by the `FeatureFusion` of each; twice the finest's size."""
    fused = None
    for level in range(len(lateral) - 1, -1, -1):
        fine = lateral[level]
        size = tuple(lateral[level - 1].shape[2:]) if level else (2 * fine.shape[2], 2 * fine.shape[3])
        fused = refine[level](fine, None, size) if fused is None else refine[level](fused, fine, size)
    assert fused is not None, "at least one map"
    return fused


def encode_positions(size: tuple[int, int], channels: int, aspect: float) -> Tensor:
    """(channels, H, W) sines and cosines of x, then of y, on a plane whose half diagonal is 1."""
    frequencies = 100.0 ** -(torch.arange(channels // 4, dtype=torch.float64) / (channels // 4))
    reach_y = 1 / (aspect**2 + 1) ** 0.5
    codes = []
    for count, reach in ((size[1], aspect * reach_y), (size[0], reach_y)):
        edge = reach * (count - 1) / count
        angles = frequencies[:, None] * torch.linspace(-edge, edge, count, dtype=torch.float64)
        codes.append(torch.cat([angles.sin(), angles.cos()]))
    x, y = codes[0][:, None, :].expand(-1, *size), codes[1][:, :, None].expand(-1, *size)
    return torch.cat([x, y])
