"""Tell objects from a printed ground by structure: whether an image shows the lines and edges that the ground has at that place.

Grey stripes may have the colours of a mottled table, but they do not run where the table's print runs.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from zeroshop_steps.geometry.channels import sum_channels

# Colours are levels of 255, likeness is zero-mean normalized cross-correlation. Set by hand on films of five things on
# printed tables (docs/results.md).
WINDOW_PX = 9  # side of the compared patches, in images of 480 px width and in cells of the ground's picture
SHIFT_PX = 1  # errors of the cameras and of the ground's flatness
NOISE_LEVELS = 3.0  # of the cameras and the video's compression
LEAST_CONTRAST = 6.0  # standard deviation of a patch; plain ones show no structure
OTHER_LIKENESS = (0.6, 0.8)  # up to the first it is not the ground's structure, from the second on it may be
PRINTED_LIKENESS = (0.5, 0.7)
"""Of the median cell in the median view: up to the first the ground shows no print that all share, from the second on it does."""
PLAIN_CELLS = 25  # diameter of what is plain; single shapes of a print are smaller
NEAR_CELLS, RISEN_LEVELS = 30, 30.0  # around a plain place: what views show there that differs by so much from the ground rises above it
SAME_HUE, RISEN_SHARE = 0.15, 0.5  # between colours of length 1; of what rises, which has the hue of the plain place
LEAST_RISEN = 3  # samples of what rises, for each cell of the plain place; fewer tell no hue
SHARED_CONTRAST = 10.0  # standard deviation of a patch of print that tells a flat thing; grain and stains have less
SHARED_LIKENESS = 0.7
EVERY = 8  # how many cells of the ground's picture there are to one that is asked


def find_other_structure(image: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(H, W) in [0, 1]: how sure it is that every patch of an image that holds the pixel shows other structure than the ground.

    Args:
        image: (H, W, 3) float32 RGB, 0 to 255.
        expected: the same, the ground's picture as the view would see it.
    """
    own, ground = _Patches.of(sum_channels(image) / 3), _Patches.of(sum_channels(expected) / 3)
    best = np.zeros(own.grey.shape, np.float32)
    for rows in range(-SHIFT_PX, SHIFT_PX + 1):
        for columns in range(-SHIFT_PX, SHIFT_PX + 1):
            best = np.maximum(best, own.compare(ground.moved(rows, columns)))
    best[own.variance < LEAST_CONTRAST**2] = 1.0
    return 1.0 - _ramp(cv2.dilate(best, np.ones((WINDOW_PX,) * 2, np.uint8)), *OTHER_LIKENESS)


def measure_print(color: np.ndarray, known: np.ndarray, samples: np.ndarray) -> float:
    """How far the views show the same print, from 0 to 1. They do not where the ground is plain, no plane, or mirrors.

    Args:
        color: (N, N, 3) float32 picture of the ground, 0 to 255.
        known: (N, N) bool: where it is known.
        samples: (V, N, N, 3) what each view sees there, NaN where it sees nothing.
    """
    if not known.any():
        return 0.0
    ground = _Patches.of(sum_channels(color) / 3)
    places = np.flatnonzero(known)[::EVERY]
    likeness = []
    for sample in samples:
        seen = np.isfinite(sample[..., 0])
        found = _Patches.of(np.where(seen, sum_channels(sample) / 3, ground.grey)).compare(ground)
        likeness.append(np.where(seen, found, np.nan).ravel()[places])
    return float(_ramp(np.median(np.nanmedian(likeness, axis=0)), *PRINTED_LIKENESS))


def find_shared_print(color: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(V, N, N) bool: where each view shows the print that the ground's picture has. Arguments as for `measure_print`."""
    ground = _Patches.of(sum_channels(color) / 3)
    printed = ground.variance > SHARED_CONTRAST**2
    shared = np.zeros(samples.shape[:3], bool)
    for alike, sample in zip(shared, samples, strict=True):
        seen = np.isfinite(sample[..., 0])
        alike[:] = seen & printed & (_Patches.of(np.where(seen, sum_channels(sample) / 3, ground.grey)).compare(ground) > SHARED_LIKENESS)
    return shared


def find_risen_plain(color: np.ndarray, known: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """(N, N) bool: large plain places of a printed ground's picture that have the hue of what rises around them, such as a bowl's floor.

    A sheet of paper has another one than what stands on it. Arguments as for `measure_print`.
    """
    plain = known & (_Patches.of(sum_channels(color) / 3).variance < LEAST_CONTRAST**2)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (PLAIN_CELLS, PLAIN_CELLS))
    count, labels = cv2.connectedComponents(cv2.morphologyEx(plain.astype(np.uint8), cv2.MORPH_OPEN, disc))
    found = np.zeros(known.shape, bool)
    for label in range(1, count):
        region = labels == label
        near = cv2.dilate(region.astype(np.uint8), np.ones((2 * NEAR_CELLS + 1,) * 2, np.uint8)) > 0
        seen, ground = samples[:, near], color[near]
        risen = seen[np.abs(seen - ground).mean(-1) > RISEN_LEVELS]  # NaN is not
        off = np.linalg.norm(_find_hue(risen) - _find_hue(np.median(color[region], axis=0)), axis=-1)
        if len(off) > LEAST_RISEN * region.sum() and (off < SAME_HUE).mean() > RISEN_SHARE:
            found |= region
    return found


def _find_hue(colors: np.ndarray) -> np.ndarray:
    """(..., 3) colours of the same brightness."""
    return colors / np.maximum(np.linalg.norm(colors, axis=-1, keepdims=True), 1.0)


def _ramp(values: ArrayLike, start: float, end: float) -> np.ndarray:
    """0 at `start` and before it, 1 at `end` and beyond it."""
    return np.clip((np.asarray(values) - start) / (end - start), 0.0, 1.0)


@dataclass(frozen=True)
class _Patches:
    """The patches around all pixels of a picture.

    Attributes:
        grey: (H, W) float32, the picture.
        mean, variance: (H, W), of each patch.
    """

    grey: np.ndarray
    mean: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, grey: np.ndarray) -> "_Patches":
        mean = _average(grey)
        return cls(grey, mean, np.maximum(_average(grey * grey) - mean * mean, 0.0))

    def moved(self, rows: int, columns: int) -> "_Patches":
        """The same, moved by whole pixels; what leaves the picture comes in on the other side."""
        return _Patches(*(np.roll(part, (rows, columns), (0, 1)) for part in (self.grey, self.mean, self.variance)))

    def compare(self, other: "_Patches") -> np.ndarray:
        """(H, W) correlation with the patches of a picture of the same size; noise makes plain ones unlike."""
        covariance: np.ndarray = _average(self.grey * other.grey) - self.mean * other.mean
        return covariance / np.sqrt((self.variance + NOISE_LEVELS**2) * (other.variance + NOISE_LEVELS**2))


def _average(values: np.ndarray) -> np.ndarray:
    return cv2.boxFilter(values, -1, (WINDOW_PX, WINDOW_PX))
