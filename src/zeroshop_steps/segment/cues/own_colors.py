"""Colours that the object has more often than what is around it, learned over all views from what was found before."""

from collections.abc import Callable

import cv2
import numpy as np

from zeroshop_steps.segment.cues import MOST_ODDS
from zeroshop_steps.segment.cues.color_model import ColorModel
from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("colors",)
RING, MARGIN = 0.6, 0.03
"""Width of the surroundings whose colours are learned, and of the rim that is not, in square roots of the hull's area."""


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """Log odds of the colours, scaled to -1 to 1."""
    if guess.hull is None:
        return None
    inside, outside = [], []
    for image, hull in zip(scene.images, guess.hull.silhouettes, strict=True):
        if not hull.any():
            continue
        size = float(np.sqrt(hull.sum()))
        depth, away = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 3) for part in (hull, ~hull))
        inside.append(image[depth > MARGIN * size][::2])
        outside.append(image[(away > MARGIN * size) & (away <= RING * size)][::4])
    if not inside or not sum(map(len, inside)) or not sum(map(len, outside)):
        return None
    colors = ColorModel(np.concatenate(inside), np.concatenate(outside))
    return lambda index: [(np.clip(colors.of(scene.images[index]), -MOST_ODDS, MOST_ODDS) / MOST_ODDS).astype(np.float32)]
