"""Tell the object from its surroundings by colour, with one model for all views."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

# Set by hand on the kitchen photos, the DTU skull and rendered films.
BINS = 24  # of each axis of CIELAB
BLUR_BINS = 0.8  # standard deviation of the smoothing over the table
DOUBT = 3e-4
"""Density that is added to every colour on both sides: a colour that neither side shows gets log odds of 0."""


class ColorModel:
    """Log odds of the object for every colour, as a table over CIELAB, in which distances are about as the eye sees them."""

    def __init__(self, inside: np.ndarray, outside: np.ndarray) -> None:
        """Learn from (N, 3) float32 RGB samples, 0 to 255, of the object and of its surroundings."""
        densities = [self._density(samples) for samples in (inside, outside)]
        self._table = np.log((densities[0] + DOUBT) / (densities[1] + DOUBT)).astype(np.float32)

    def of(self, image: np.ndarray) -> np.ndarray:
        """(H, W) log odds for an (H, W, 3) float32 RGB image."""
        cells = self._cells(image.reshape(-1, 3))
        return self._table[tuple(cells.T)].reshape(image.shape[:2])

    @staticmethod
    def _cells(colors: np.ndarray) -> np.ndarray:
        lab = cv2.cvtColor(np.ascontiguousarray(colors[None], np.float32) / 255.0, cv2.COLOR_RGB2LAB)[0]
        scaled = (lab + [0, 80, 80]) / [100.01, 160.0, 160.0] * BINS
        return np.clip(scaled, 0, BINS - 1).astype(np.int64)

    def _density(self, samples: np.ndarray) -> np.ndarray:
        cells = self._cells(samples)
        flat = np.ravel_multi_index(tuple(cells.T), (BINS,) * 3)
        counts = np.bincount(flat, minlength=BINS**3).reshape((BINS,) * 3).astype(np.float64)
        return gaussian_filter(counts, BLUR_BINS, mode="nearest") / max(len(samples), 1)
