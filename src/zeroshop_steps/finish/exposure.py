"""Exposure: photos of one object are not equally bright, since cameras choose it anew for each."""

import numpy as np

ROUNDS = 5
LEAST_POINTS = 50
GAIN_RANGE = (0.5, 2.0)
DARKEST = 0.02
"""Brightness of 1 below which a point tells nothing of a ratio."""


def estimate_gains(brightness: np.ndarray, weight: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """(V,) factors that make photos equally bright: the median ratio between what all photos and what each shows.

    Args:
        brightness: (N, V) of surface points in each photo, 0 to 1.
        weight: (N, V) how well each photo shows them, 0 where it does not.
        usable: (N, V) bool, which of them count for a photo, where another one shows them, too.
    """
    found = np.ones(brightness.shape[1], np.float32)
    usable = usable & (brightness > DARKEST) & ((weight > 0).sum(1) > 1)[:, None]
    for _ in range(ROUNDS):
        mean = (brightness * found * weight).sum(1) / np.maximum(weight.sum(1), 1e-12)
        for k in range(len(found)):
            good = usable[:, k]
            if good.sum() >= LEAST_POINTS:
                found[k] = np.clip(np.median(mean[good] / brightness[good, k]), *GAIN_RANGE)
        found /= np.exp(np.log(found).mean())
    return found
