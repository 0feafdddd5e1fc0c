"""A grid of cells over a picture, which tells how much of it features or matches cover."""

import numpy as np

CELLS = 8  # along each side of a picture


def find_cells(keypoints: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """(K,) numbers of the cells of a picture of (width, height) in which (K, 2) keypoints lie."""
    columns, rows = np.clip(np.floor(keypoints / size_px * CELLS).astype(int), 0, CELLS - 1).T
    return np.asarray(rows * CELLS + columns)
