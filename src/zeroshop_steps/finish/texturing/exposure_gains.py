"""Differences of exposure: cameras expose each photo anew, so the same spot is brighter in one photo than in another."""

import numpy as np

from zeroshop_steps.geometry.alignment.robust_estimates import MEDIAN_POINTS
from zeroshop_steps.geometry.imaging.images import EXPOSURE_RANGE

ROUNDS = 5  # the mean depends on the gains and they on the mean, so both are computed in turns
DARKEST = 0.02  # brightness, of 1; below, noise dominates the ratio of two photos


def estimate_gains(brightness: np.ndarray, weight: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """(V,) factors that make V photos equally bright: the median ratio between the mean of all photos and each of them.

    Args:
        brightness: (N, V) of N surface points in each photo, 0 to 1.
        weight: (N, V) how well each photo shows a point; 0 where it does not.
        usable: (N, V) bool, the points that may be used for a photo; of these, those that another photo shows as well are.
    """
    found = np.ones(brightness.shape[1], np.float32)
    usable = usable & (brightness > DARKEST) & ((weight > 0).sum(1) > 1)[:, None]
    for _ in range(ROUNDS):
        mean = (brightness * found * weight).sum(1) / np.maximum(weight.sum(1), 1e-12)
        for k in range(len(found)):
            good = usable[:, k]
            if good.sum() >= MEDIAN_POINTS:
                found[k] = np.clip(np.median(mean[good] / brightness[good, k]), *EXPOSURE_RANGE)
        found /= np.exp(np.log(found).mean())
    return found
