"""What a photo shows of a board."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BoardView:
    """The corners of the board in one photo.

    Attributes:
        name: of the photo.
        numbers: (N,) corners, indices into the board's `corners_mm`.
        rays: (N, 2) where they lie in the camera's image plane at depth 1.
        camera_from_world: (4, 4).
        focal_px: pixels a unit of `rays`.
        square_px: side of a square or tag in the photo, the median.
    """

    name: str
    numbers: np.ndarray
    rays: np.ndarray
    camera_from_world: np.ndarray
    focal_px: float
    square_px: float
