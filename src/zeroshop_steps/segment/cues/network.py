"""What a salient-object network sees in each photo alone."""

from collections.abc import Callable

import numpy as np
from scipy.special import logit

from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("network", "network_known")
LEAST = 0.01  # probability, and the most is 1 less this; networks are more sure of themselves than right


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """Log odds of the network, scaled to -1 to 1."""
    saliency = scene.saliency
    if saliency is None:
        return None

    def see(index: int) -> list[np.ndarray]:
        odds = logit(np.clip(saliency[index], LEAST, 1 - LEAST)) / logit(1 - LEAST)
        return [odds.astype(np.float32), np.ones_like(saliency[index])]

    return see
