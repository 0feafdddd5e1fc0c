"""Where the object is by what all views said before: silhouettes of what so many of the others show, and those of other things."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.segment.scene import Guess, MaskScene
from zeroshop_steps.segment.support_voxels import SHARES

CHANNELS = ("hull", *(f"shown_by_{share:.0%}" for share in SHARES), "other_thing")
REACH = 0.2  # distance from an outline at which the channels saturate, in square roots of the hull's area


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """The signed distances from the outlines, positive inside."""
    hull = guess.hull
    if hull is None:
        return None

    def see(index: int) -> list[np.ndarray]:
        silhouette, shares, other = hull.silhouettes[index], hull.shares[index], hull.others[index]
        reach = REACH * float(np.sqrt(max(silhouette.sum(), 1)))
        parts = [silhouette, *(shares >= share for share in SHARES)]
        return [*(_measure_distance(part, reach) for part in parts), other.astype(np.float32)]

    return see


def _measure_distance(part: np.ndarray, reach: float) -> np.ndarray:
    if part.all() or not part.any():
        return np.full(part.shape, 1.0 if part.any() else -1.0, np.float32)
    inside, outside = (cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, 3) for side in (part, ~part))
    return np.clip((inside - outside) / reach, -1, 1).astype(np.float32)
