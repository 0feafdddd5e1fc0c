"""What makes a picture usable: is it sharp, is it light enough, does it show something new?"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.files import write_json

SMALL_WIDTH_PX = 320
THUMBNAIL_PX = (64, 48)
ALIKE_LEVELS = 4.0
DARK_LEVEL, DARK_SHARE = 45.0, 0.5
BLURRED_SHARE = 0.35
SHEET_COLUMNS, TILE_WIDTH_PX = 5, 320


def small_grey(image: np.ndarray) -> np.ndarray:
    """(h, w) float32 grey picture, `SMALL_WIDTH_PX` wide, of an (H, W, 3) uint8 RGB image."""
    height = max(1, round(image.shape[0] * SMALL_WIDTH_PX / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (SMALL_WIDTH_PX, height), interpolation=cv2.INTER_AREA).astype(np.float32)


def sharpness(image: np.ndarray) -> float:
    """Mean absolute Laplacian over mean level of an RGB image: lower where it is blurred, however light it is."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    width = min(3 * SMALL_WIDTH_PX, image.shape[1])
    grey = cv2.resize(grey, (width, max(1, round(image.shape[0] * width / image.shape[1]))), interpolation=cv2.INTER_AREA)
    return float(np.abs(cv2.Laplacian(grey.astype(np.float32), cv2.CV_32F)).mean() / (grey.mean() + 1.0))


def thumbnail(image: np.ndarray) -> np.ndarray:
    """(48, 64) float32 grey picture of an RGB image, for comparing views."""
    return cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), THUMBNAIL_PX, interpolation=cv2.INTER_AREA).astype(np.float32)


def alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two thumbnails show the same view: 99 % of their pixels differ by less than `ALIKE_LEVELS` of 255."""
    return bool(np.percentile(np.abs(one - other), 99) < ALIKE_LEVELS)


def picture_warnings(names: list[str], sharpnesses: Sequence[float], levels: Sequence[float]) -> list[str]:
    """What to film again, from the sharpness and the mean level (0 to 255) of every picture."""
    warnings = []
    usual = float(np.median(sharpnesses))
    blurred = [name for name, value in zip(names, sharpnesses, strict=True) if value < BLURRED_SHARE * usual]
    if blurred:
        warnings.append(f"blurred, much more than the others: {', '.join(blurred)}; hold the camera still, or move it more slowly")
    dark = [name for name, level in zip(names, levels, strict=True) if level < DARK_LEVEL]
    if len(dark) > DARK_SHARE * len(names):
        warnings.append(f"{len(dark)} of {len(names)} pictures are dark: put more light on the object")
    elif dark:
        warnings.append(f"darker than they should be: {', '.join(dark)}")
    return warnings


def contact_sheet(images: list[np.ndarray], names: list[str]) -> np.ndarray:
    """(H, W, 3) uint8: all pictures, small, in rows, with their names."""
    tiles = []
    for image, name in zip(images, names, strict=True):
        tile = cv2.resize(
            image, (TILE_WIDTH_PX, max(1, round(image.shape[0] * TILE_WIDTH_PX / image.shape[1]))), interpolation=cv2.INTER_AREA
        )
        cv2.putText(tile, name, (5, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    return rows_of(tiles)


def rows_of(tiles: list[np.ndarray]) -> np.ndarray:
    """Pictures of one size in rows of `SHEET_COLUMNS`."""
    tiles = tiles + [np.zeros_like(tiles[0])] * (-len(tiles) % SHEET_COLUMNS)
    return np.vstack([np.hstack(tiles[start : start + SHEET_COLUMNS]) for start in range(0, len(tiles), SHEET_COLUMNS)])


def write_record(
    folder: Path,
    size_px: tuple[int, int],
    height_m: float | None,
    sharpnesses: Sequence[float],
    levels: Sequence[float],
    facts: dict[str, Any],
) -> None:
    """Write the capture.json of real pictures.

    Args:
        folder: the capture.
        size_px: (width, height) of every picture.
        height_m: of the object, None where unknown.
        sharpnesses, levels: of every picture.
        facts: further ones; warnings and seconds belong to them.
    """
    write_json(
        folder / "capture.json",
        {
            "scene": "video",
            "virtual": False,
            "seed": None,
            "width_px": size_px[0],
            "height_px": size_px[1],
            "images": len(levels),
            "known_height_m": height_m,
            "sharpness": [round(float(value), 4) for value in sharpnesses],
            "level": [round(float(value), 1) for value in levels],
            **facts,
        },
    )
