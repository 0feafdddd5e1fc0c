"""The sizes of the network; those of DA3-SMALL by default."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Da3Settings:
    """What a checkpoint does not say by its shapes, and what shapes the network.

    Attributes:
        image_px: longer side of the images that the network is given.
        patch_px: side of a patch.
        grid: patches a side of the square images that its positions were learned on.
        grid_offset: added to the size of the grid that positions are resampled to: DINOv2 was trained with that.
        width: of a token; those of the heads are twice as wide.
        depth: blocks of attention.
        heads: of each.
        alone: so many blocks see one image each, as in DINOv2; of those after, every second sees all images.
        chosen_from: images; of fewer, the first is the reference.
        layers: the blocks whose output the heads read; each sees all images.
        camera_depth, camera_heads: blocks of the encoder of known cameras, and heads of their attention.
        dense_features: channels of the maps of depth and rays; `dense_channels`: of their four inputs.
    """

    image_px: int = 504
    patch_px: int = 14
    grid: int = 37
    grid_offset: float = 0.1
    width: int = 384
    depth: int = 12
    heads: int = 6
    alone: int = 4
    chosen_from: int = 3
    layers: tuple[int, int, int, int] = (5, 7, 9, 11)
    camera_depth: int = 4
    camera_heads: int = 16
    dense_features: int = 64
    dense_channels: tuple[int, int, int, int] = (48, 96, 192, 384)


SMALL = Da3Settings()
BASE = Da3Settings(width=768, heads=12, dense_features=128, dense_channels=(96, 192, 384, 768))
