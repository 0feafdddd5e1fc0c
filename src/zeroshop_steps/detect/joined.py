"""Masks of one object that a detector found in two parts: a drill's body and its handle, a mug and what its shadow cut off."""

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

TOUCH_PX = 3  # masks so near to each other touch
MOST_SHARED = 0.3  # of the smaller mask: what shares more is the same part, found twice


def join_touching(masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The unions of each two of (height, width) bool masks that touch and are not the same part."""
    return [one | other for one, other in combinations(masks, 2) if _touch(one, other)]


def _touch(one: np.ndarray, other: np.ndarray) -> bool:
    around = np.ones((2 * TOUCH_PX + 1,) * 2, np.uint8)
    if not (cv2.dilate(one.astype(np.uint8), around).astype(bool) & other).any():
        return False
    return bool((one & other).sum() <= MOST_SHARED * min(one.sum(), other.sum()))
