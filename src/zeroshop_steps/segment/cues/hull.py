"""Where the object is by what all views said before: its hull's silhouette, and those of other things."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("hull", "other_thing")
REACH = 0.2  # distance from the silhouette's outline at which the channel saturates, in square roots of its area


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """The signed distance from the outline, positive inside."""
    if guess.hulls is None or guess.others is None:
        return None
    hulls, others = guess.hulls, guess.others

    def see(index: int) -> list[np.ndarray]:
        hull = hulls[index]
        if not hull.any():
            return [np.zeros(hull.shape, np.float32), others[index].astype(np.float32)]
        inside, outside = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 3) for part in (hull, ~hull))
        distance = np.clip((inside - outside) / (REACH * np.sqrt(hull.sum())), -1, 1)
        return [distance.astype(np.float32), others[index].astype(np.float32)]

    return see
