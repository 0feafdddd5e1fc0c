"""What a salient-object network sees in each photo alone, and how far that agrees with what the other photos show."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import logit

from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.segment.scene import Guess, MaskScene

CHANNELS = ("network", "network_agrees", "closer_network", "closer_network_agrees", "network_known")
LEAST = 0.01  # probability, and the most is 1 less this; networks are more sure of themselves than right


def prepare(scene: MaskScene, guess: Guess) -> Callable[[int], list[np.ndarray]] | None:
    """Log odds of the network in the whole photos and in windows of them, scaled to -1 to 1; and of each the overlap with the other views.

    A network takes another thing in single photos, or more than one: then it is wrong in all of the photo.
    """
    whole = scene.saliency
    if whole is None:
        return None
    closer = scene.closer_saliency if scene.closer_saliency is not None else whole

    def see(index: int) -> list[np.ndarray]:
        shared = None if guess.hull is None else guess.hull.find_shared(index)
        channels = [channel for maps in (whole, closer) for channel in _rate(maps, index, shared)]
        return [*channels, np.ones_like(whole[index])]

    return see


def _rate(maps: Sequence[np.ndarray], index: int, shared: np.ndarray | None) -> list[np.ndarray]:
    seen = maps[index]
    odds = logit(np.clip(seen, LEAST, 1 - LEAST)) / logit(1 - LEAST)
    agrees = 0.0 if shared is None else compute_overlap(seen > 0.5, shared)
    return [odds.astype(np.float32), np.full_like(seen, agrees)]
