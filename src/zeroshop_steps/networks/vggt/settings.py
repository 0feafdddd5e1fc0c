"""The sizes of the network; those of VGGT-1B by default."""

from dataclasses import dataclass


@dataclass(frozen=True)
class VggtSettings:
    """What a checkpoint does not say by its shapes, and what shapes the network.

    Attributes:
        image_px: longer side of the images that the network knows.
        patch_px: side of a patch.
        width: of a token; those of the heads are twice as wide.
        depth: pairs of a frame and a global attention block.
        embed_depth: blocks of the patch embedding.
        heads: of each attention but the tracker's.
        registers: extra tokens of a frame.
        layers: the pairs whose output the dense heads read; the last is also what the camera head reads.
        camera_depth: blocks of the camera head.
        dense_features: channels of the depth and point heads; `dense_channels`: of their four inputs.
        track_stride: pixels of the image for each pixel of the tracker's maps.
        track_features: channels of the tracker's maps; `track_channels`: of their four inputs.
        track_width, track_heads, track_depth: of the tracker's tokens, attention and blocks; `virtual_tracks`: extra tokens.
        track_levels, track_radius: of its correlations; maps each half the last, and pixels around the estimate.
    """

    image_px: int = 518
    patch_px: int = 14
    width: int = 1024
    depth: int = 24
    embed_depth: int = 24
    heads: int = 16
    registers: int = 4
    layers: tuple[int, int, int, int] = (4, 11, 17, 23)
    camera_depth: int = 4
    dense_features: int = 256
    dense_channels: tuple[int, int, int, int] = (256, 512, 1024, 1024)
    track_stride: int = 2
    track_features: int = 128
    track_channels: tuple[int, int, int, int] = (256, 512, 1024, 1024)
    track_width: int = 384
    track_heads: int = 8
    track_depth: int = 6
    track_levels: int = 7
    track_radius: int = 4
    virtual_tracks: int = 64
