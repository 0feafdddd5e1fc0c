"""The sizes of the networks, and what their weights were trained with."""

from dataclasses import dataclass

CROP_PX = 160
"""Side of the crops that both networks see."""
REFINER_MARGIN, SCORER_MARGIN = 1.2, 1.1
"""Side of a crop at the object's depth, in diameters of the object."""
LARGEST_TURN_RAD = 0.3490658503988659
"""20 degrees: the most that one refinement turns about each axis."""


@dataclass(frozen=True)
class FoundationPoseSettings:
    """Sizes of a network; by default those of the published refiner and scorer.

    Attributes:
        image_channels: of an image: its colours, then where its points are.
        stem: channels after the first convolution.
        width: channels of the features of each image; those of a pair have twice as many.
        tokens: width of the tokens that the attention sees.
        heads: of each attention.
        hidden: width between the two linear layers of a transformer block.
        most_tokens: rows of the table of positions.
    """

    image_channels: int = 6
    stem: int = 64
    width: int = 128
    tokens: int = 512
    heads: int = 4
    hidden: int = 512
    most_tokens: int = 400
