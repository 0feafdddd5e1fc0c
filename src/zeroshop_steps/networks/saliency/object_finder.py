"""The main thing of what a salient-object network sees in a single photo."""

from collections.abc import Sequence

import cv2
import numpy as np

PART_GAP = 0.05  # shares of the square root of the main thing's area: what is nearer to it is a part of it


def cut_main_things(maps: Sequence[np.ndarray], sizes_px: Sequence[tuple[int, int]]) -> list[np.ndarray]:
    """(H, W) bool masks of the main thing in each photo, of the photos' (width, height), by their maps."""
    return [cv2.resize(keep_main_thing(found), size) > 0.5 for found, size in zip(maps, sizes_px, strict=True)]


def surround_main_thing(found: np.ndarray, margin: float) -> tuple[slice, slice] | None:
    """Rows and columns of a map, (h, w), around the main thing and a margin, a share of its longer side; None where there is none."""
    rows, columns = np.nonzero(keep_main_thing(found) > 0.5)
    if not len(rows):
        return None
    aside = round(margin * float(max(np.ptp(rows), np.ptp(columns))))
    top, left = max(0, int(rows.min()) - aside), max(0, int(columns.min()) - aside)
    return slice(top, int(rows.max()) + aside + 1), slice(left, int(columns.max()) + aside + 1)


def keep_main_thing(found: np.ndarray) -> np.ndarray:
    """A map, (h, w), with only the largest thing near the middle of the photo, and what nearly touches it: without cameras, nothing else
    tells the object from other things."""
    count, labels, stats, centroids = cv2.connectedComponentsWithStats((found > 0.5).astype(np.uint8), connectivity=8)
    if count <= 2:
        return found
    middle = np.array([found.shape[1], found.shape[0]]) / 2
    away = np.linalg.norm(centroids[1:] - middle, axis=1) / np.linalg.norm(middle)
    main = 1 + int((stats[1:, cv2.CC_STAT_AREA] * (1 - away)).argmax())
    reach = max(1, round(PART_GAP * float(np.sqrt(stats[main, cv2.CC_STAT_AREA]))))
    near = cv2.distanceTransform((labels != main).astype(np.uint8), cv2.DIST_L2, 3) <= reach
    kept = np.isin(labels, [0, *np.unique(labels[near])])
    return np.where(kept, found, np.float32(0))
