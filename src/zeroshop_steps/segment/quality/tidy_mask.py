"""Tidy a mask by the silhouette of the hull that all photos share."""

import cv2
import numpy as np

# Shares of a mask's area: separate parts below the first are dropped, holes up to the second are filled.
LEAST_ISLAND, LARGEST_FILLED_HOLE = 0.05, 0.003
MOSTLY = 0.5  # of a separate part must lie in the common hull
CLOSED_SHARE = 0.9  # a larger hole is filled if this share of it lies in the hull: the other views see no way through


def tidy_mask(mask: np.ndarray, hull: np.ndarray) -> np.ndarray:
    """The (H, W) float32 mask without small or separate parts off the common hull's silhouette, (H, W) bool, and without small holes.

    A larger hole is filled where the other views see no way through: print may have the ground's colours.
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats((mask > 0.5).astype(np.uint8), connectivity=8)
    if count < 2:
        return np.zeros_like(mask)
    areas = stats[1:, cv2.CC_STAT_AREA]
    shared = np.bincount(labels[hull], minlength=count)[1:]
    kept = np.flatnonzero((areas >= LEAST_ISLAND * areas.max()) & (shared > MOSTLY * areas)) + 1
    mask = np.where((mask <= 0.5) | np.isin(labels, kept), mask, 0.0)
    count, labels, stats, _ = cv2.connectedComponentsWithStats((mask <= 0.5).astype(np.uint8), connectivity=4)
    covered = np.bincount(labels[hull], minlength=count) / np.maximum(stats[:, cv2.CC_STAT_AREA], 1)
    small = stats[:, cv2.CC_STAT_AREA] <= LARGEST_FILLED_HOLE * areas.sum()
    holes = [number for number in range(1, count) if small[number] or covered[number] > CLOSED_SHARE]
    return np.where(np.isin(labels, holes), 1.0, mask).astype(np.float32)
