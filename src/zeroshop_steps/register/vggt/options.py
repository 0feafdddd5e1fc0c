"""Parameters of registration by VGGT."""

from dataclasses import dataclass, field

from zeroshop_steps.register.pipeline import StructureOptions


@dataclass(frozen=True)
class VggtOptions:
    """Parameters of the method.

    Attributes:
        refine: "tracks" refines the cameras by tracks and bundle adjustment; "none" takes them as the network says them.
        tracked_points: points to follow a query view, at most.
        query_views: views whose points are followed; each costs a pass of the network.
        lens: camera model of the one lens for all: SIMPLE_RADIAL or SIMPLE_PINHOLE.
        max_error_px: largest reprojection error of a track that counts in the end, per 1000 px of image width.
        precision: of the attention: auto, float32 or bfloat16.
        min_visibility: from where on a tracked point counts as seen.
        min_confidence: of a depth value, for feed-forward points; the network's confidences start at 1.
        min_observations: an image with fewer points is not registered.
        min_agreement: share of the feed-forward points that other views' depth must confirm, in each image.
        unrefined_px: mask rays of feed-forward cameras may miss the other masks by this much, per 1000 px of width.
        structure: of the reconstruction; of the object only, images are black outside the masks, and points lie inside them.
    """

    refine: str = "tracks"
    tracked_points: int = 1024
    query_views: int = 8
    lens: str = "SIMPLE_RADIAL"
    max_error_px: float = 4.0
    precision: str = "auto"
    min_visibility: float = 0.2
    min_confidence: float = 5.0
    min_observations: int = 30
    min_agreement: float = 0.5
    unrefined_px: float = 20.0
    structure: StructureOptions = field(default_factory=lambda: StructureOptions(max_dropped=3))
