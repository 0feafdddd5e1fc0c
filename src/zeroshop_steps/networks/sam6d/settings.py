"""Sizes and constants of the network."""

from dataclasses import dataclass

IMAGE_PX, PATCH_PX = 224, 16  # of the square crops, and of the patches that become tokens
GRID = IMAGE_PX // PATCH_PX


@dataclass(frozen=True)
class Sam6dSettings:
    """Sizes of the network; by default those of the published one.

    Attributes:
        vision_channels, vision_depth, vision_heads: of the image's transformer, a ViT-Base; its depth is a multiple of four.
        features: of a pixel, and of a point before and after matching.
        channels: of a point while points are matched.
        heads: of all attention between points.
        blocks: of the coarse and of the fine matching.
        temperature: by which cosines of features are divided before they become probabilities.
        neighbours: of a point, between whose directions and that of another point angles are taken.
        sparse_points: of each cloud, in the coarse matching.
        dense_points: of each cloud, in the fine matching.
        hypotheses, kept_hypotheses: of the coarse pose, before and after the first choice.
    """

    vision_channels: int = 768
    vision_depth: int = 12
    vision_heads: int = 12
    features: int = 256
    channels: int = 256
    heads: int = 4
    blocks: int = 3
    temperature: float = 0.1
    neighbours: int = 3
    sparse_points: int = 196
    dense_points: int = 2048
    hypotheses: int = 6000
    kept_hypotheses: int = 300
