"""Parameters of registration by Depth Anything 3."""

from dataclasses import dataclass, field

from zeroshop_steps.register.colmap import ColmapOptions


@dataclass(frozen=True)
class Da3Options:
    """Parameters of the method.

    Attributes:
        refine: "matches" refines the cameras by SIFT's matches; "none" takes them as the network says them.
        precision: of the attention: auto, float32 or bfloat16.
        max_error_px: largest reprojection error of a track after its first adjustment, per 1000 px of image width.
        min_observations: an image that sees fewer tracks is not held by matches; COLMAP may still place it.
        unsure_share: of the depths of all images, the least sure ones give no points: their confidence has no unit.
        min_agreement: share of the points by depth that other views' depth must confirm, in each image.
        unrefined_px: mask rays of cameras that were not refined may miss the other masks by this much, per 1000 px of width.
        colmap: of the features, their matches, and the reconstruction from them.
    """

    refine: str = "matches"
    precision: str = "auto"
    max_error_px: float = 4.0
    min_observations: int = 30
    unsure_share: float = 0.4
    min_agreement: float = 0.5
    unrefined_px: float = 20.0
    colmap: ColmapOptions = field(default_factory=ColmapOptions)
