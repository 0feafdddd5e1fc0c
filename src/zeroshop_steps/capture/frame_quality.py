"""Measure whether an image is usable: is it sharp, is it bright enough, does it show something new?"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.contact_sheets import arrange_in_rows, tile_size_px, write_label
from zeroshop_steps.runtime.files import write_json

# Levels are of 255. Set by hand on the kitchen photos, DTU, DexYCB and rendered films.
SMALL_WIDTH_PX = 320  # of grey images that are compared from frame to frame
ALIKE_LEVELS = 4.0  # noise and compression change a thumbnail by less, another view by more
COPY_LEVELS = 2.0  # by which a thumbnail differs at most where the photo was compressed anew, or taken anew from a tripod
DARK_LEVEL, DARK_SHARE = 45.0, 0.5  # mean level of a dark image, and the share of such images that speaks of the light, not of them
BLACK_LEVEL, LEAST_SEEN_SHARE = 16, 0.005  # of black cloth or a removed background, compressed; and of the image that may be seen alone
BRIGHT_SHARE, LEVEL_STEP_PX = 0.1, 4  # of what is seen: the object behind a flash; and every so many pixels are looked at
BLURRED_SHARE = 0.35  # of the usual sharpness
SHARPNESS_WIDTH_PX, EDGE_SMOOTHING_PX, REBLUR_PX = 960, 0.7, 1.5  # width to which images are reduced; deviations of the two blurs
# An edge is at least so steep, and among this share of steepest pixels; its sharpest share counts, of no fewer edges than these.
EDGE_LEVELS, STRONG_EDGES, SHARPEST, LEAST_EDGES = 16.0, 0.1, 0.1, 50
MOST_EDGE_BLUR_PX = 1.5
"""Sharp photos have 0.4 to 1.0, the same blurred by 3 px have 1.8 to 2.4 (kitchen, DTU, DexYCB, rendered)."""


def shrink_to_grey(image: np.ndarray) -> np.ndarray:
    """(h, w) float32 grey picture, `SMALL_WIDTH_PX` wide, of an (H, W, 3) uint8 RGB image."""
    return _resize_to_grey(image, SMALL_WIDTH_PX)


def bound_to_grey(image: np.ndarray, longer_px: int) -> np.ndarray:
    """(h, w) uint8 grey picture of an (H, W, 3) uint8 RGB image, reduced to a longer side of at most `longer_px`."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    scale = min(1.0, longer_px / max(grey.shape))
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def measure_sharpness(image: np.ndarray) -> float:
    """Mean absolute Laplacian over mean level of an RGB image: lower where it is blurred, whatever its brightness."""
    grey = _resize_to_grey(image, min(SHARPNESS_WIDTH_PX, image.shape[1]))
    return float(np.abs(cv2.Laplacian(grey, cv2.CV_32F)).mean() / (grey.mean() + 1.0))


def measure_edge_blur_px(image: np.ndarray) -> float:
    """The width of the sharpest edges of an (H, W, 3) RGB image: the standard deviation of their blur, in pixels of an image 960 px wide.

    From how much weaker a strong edge becomes when it is blurred once more (Zhuo and Sim, Defocus map estimation from a single
    image, 2011). 0 where there are too few edges to tell.
    """
    calm = cv2.GaussianBlur(_resize_to_grey(image, min(SHARPNESS_WIDTH_PX, image.shape[1])), (0, 0), EDGE_SMOOTHING_PX)
    slope, blurred = _compute_gradient(calm), _compute_gradient(cv2.GaussianBlur(calm, (0, 0), REBLUR_PX))
    ridge = blurred >= cv2.dilate(blurred, np.ones((3, 3)))
    edges = ridge & (blurred > max(float(np.quantile(blurred, 1 - STRONG_EDGES)), EDGE_LEVELS))
    if edges.sum() < LEAST_EDGES:
        return 0.0
    ratio = slope[edges] / blurred[edges]
    return float(np.quantile(REBLUR_PX / np.sqrt(np.maximum(ratio**2 - 1, 1e-3)), SHARPEST))


def measure_level(image: np.ndarray) -> float:
    """Mean level, 0 to 255, of what is not black in an (H, W, 3) RGB or (H, W) grey image; or half that of its brightest part, if more.

    A background that was removed, or is dark as behind a flash, says nothing of the light on the object.
    """
    few = image[::LEVEL_STEP_PX, ::LEVEL_STEP_PX]
    grey = few if few.ndim == 2 else few.mean(2)
    seen = grey[grey > BLACK_LEVEL]
    if len(seen) < LEAST_SEEN_SHARE * grey.size:
        return float(grey.mean())
    bright = seen[seen >= np.quantile(seen, 1 - BRIGHT_SHARE)]
    return float(max(seen.mean(), bright.mean() / 2))


def _resize_to_grey(image: np.ndarray, width_px: int) -> np.ndarray:
    height_px = max(1, round(image.shape[0] * width_px / image.shape[1]))
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.resize(grey, (width_px, height_px), interpolation=cv2.INTER_AREA).astype(np.float32)


def _compute_gradient(grey: np.ndarray) -> np.ndarray:
    return np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))


def make_thumbnail(image: np.ndarray) -> np.ndarray:
    """(48, 64) float32 grey picture of an RGB image, for comparing views."""
    return cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (64, 48), interpolation=cv2.INTER_AREA).astype(np.float32)


def look_alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two thumbnails show the same view: 99 % of their pixels differ by less than `ALIKE_LEVELS` of 255."""
    # Of the pixels' differences, so that a few may differ.
    return bool(np.percentile(np.abs(one - other), 99) < ALIKE_LEVELS)


def is_copy(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two thumbnails are of one photo, or of two that show the same to the last pixel."""
    return bool(np.abs(one - other).max() <= COPY_LEVELS)


def collect_image_warnings(names: list[str], sharpnesses: Sequence[float], levels: Sequence[float], blurs_px: Sequence[float]) -> list[str]:
    """Warnings on what to film again, from the sharpness, the level (`measure_level`) and the blur of the edges of every image."""
    warnings = []
    usual = float(np.median(sharpnesses))
    blurred = [name for name, value in zip(names, sharpnesses, strict=True) if value < BLURRED_SHARE * usual]
    usual_px = float(np.median(blurs_px))
    if usual_px > MOST_EDGE_BLUR_PX:
        warnings.append(
            f"blurred throughout: even the sharpest edges are smeared by {usual_px:.1f} px; focus on the object, hold the camera still, use"
            " more light, clean the lens"
        )
    if blurred:
        warnings.append(f"blurred, much more than the others: {', '.join(blurred)}; hold the camera still, or move it more slowly")
    dark = [name for name, level in zip(names, levels, strict=True) if level < DARK_LEVEL]
    if len(dark) > DARK_SHARE * len(names):
        warnings.append(f"{len(dark)} of {len(names)} pictures are dark: put more light on the object")
    elif dark:
        warnings.append(f"darker than they should be: {', '.join(dark)}; put more light there, or leave them out")
    return warnings


def draw_contact_sheet(images: Iterable[np.ndarray], names: list[str]) -> np.ndarray:
    """(H, W, 3) uint8: all pictures, small, in rows, with their names."""
    tiles = []
    for image, name in zip(images, names, strict=True):
        tile = cv2.resize(image, tile_size_px(image), interpolation=cv2.INTER_AREA)
        write_label(tile, name)
        tiles.append(tile)
    return arrange_in_rows(tiles)


def write_capture_record(
    folder: Path,
    sizes_px: Sequence[tuple[int, int]],
    sharpnesses: Sequence[float] | np.ndarray,
    levels: Sequence[float] | np.ndarray,
    blurs_px: Sequence[float],
    facts: dict[str, Any],
) -> None:
    """Write the capture.json of real pictures.

    Args:
        folder: the capture.
        sizes_px: (width, height) of every picture; the record has the most frequent one, and all where they differ.
        sharpnesses, levels, blurs_px: of every picture.
        facts: further ones; warnings and seconds belong to them.
    """
    usual = max(sorted(set(sizes_px)), key=list(sizes_px).count)
    differing = {} if len(set(sizes_px)) == 1 else {"sizes_px": [list(size) for size in sizes_px]}
    write_json(
        folder / "capture.json",
        {
            "scene": "video",
            "virtual": False,
            "seed": None,
            "width_px": usual[0],
            "height_px": usual[1],
            **differing,
            "images": len(levels),
            "sharpness": [round(float(value), 4) for value in sharpnesses],
            "level": [round(float(value), 1) for value in levels],
            "edge_blur_px": [round(float(value), 2) for value in blurs_px],
            **facts,
        },
    )
