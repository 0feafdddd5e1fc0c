"""Contact sheets: many small pictures with their names in one."""

import cv2
import numpy as np

COLUMNS, TILE_WIDTH_PX = 5, 320
RED, GREEN = (255, 0, 0), (0, 255, 0)
"""Outlines and crosses over photos; too large and too small, where masks are compared."""
LABEL_CORNER_PX, LABEL_SCALE, LABEL_COLOR = (5, 18), 0.5, (255, 255, 255)
"""Baseline of a tile's name, its size as a share of OpenCV's font, and its colour: letters 11 px high, white, readable on most photos."""


def tile_size_px(image: np.ndarray) -> tuple[int, int]:
    """(width, height) of the tile of an (H, W, ...) image."""
    return TILE_WIDTH_PX, max(1, round(image.shape[0] * TILE_WIDTH_PX / image.shape[1]))


def write_label(tile: np.ndarray, text: str) -> None:
    """Write a name into the upper left corner of a tile, in place."""
    cv2.putText(tile, text, LABEL_CORNER_PX, cv2.FONT_HERSHEY_SIMPLEX, LABEL_SCALE, LABEL_COLOR, 1, cv2.LINE_AA)


def arrange_in_rows(tiles: list[np.ndarray]) -> np.ndarray:
    """Pictures of one width in rows of `COLUMNS`; below lower ones there is black."""
    height_px = max(tile.shape[0] for tile in tiles)
    padded = [np.pad(tile, ((0, height_px - tile.shape[0]), (0, 0), (0, 0))) for tile in tiles]
    padded += [np.zeros_like(padded[0])] * (-len(tiles) % COLUMNS)
    return np.vstack([np.hstack(padded[start : start + COLUMNS]) for start in range(0, len(padded), COLUMNS)])
