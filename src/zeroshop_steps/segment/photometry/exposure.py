"""Exposure and white balance that change from photo to photo are undone, once for all stages that read the photos."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.geometry.imaging.images import read_image, write_image
from zeroshop_steps.geometry.imaging.srgb import linear_to_srgb, srgb_to_linear
from zeroshop_steps.runtime.compute.thread_pool import map_in_threads
from zeroshop_steps.runtime.errors import warn
from zeroshop_steps.runtime.files import write_json
from zeroshop_steps.segment.photometry.color_gains import Gains, estimate_gains
from zeroshop_steps.segment.photometry.shared_colors import SharedColors, sample_shared_colors

RECORD = "exposure.json"
EXTREME_GAIN = 1.6  # and its inverse: from here on, noise and clipped pixels show
CLIPPED_SHARE = 0.1  # of a photo's points whose colour is lost; from here on a warning is due


@dataclass(frozen=True)
class Exposure:
    """How photos differ in exposure and white balance.

    Attributes:
        log_gains: (V, 3) natural logarithms of the factors of linear light that make them equal.
        corrected: whether they differ enough to be corrected.
        photos: for exposure.json, the figures of each photo.
    """

    log_gains: np.ndarray
    corrected: bool
    photos: list[dict[str, Any]]


def estimate_exposure(folder: Path, views: Sequence[View]) -> Exposure:
    """Estimate the exposure of the views of a cameras folder, from the colours that they show at their common points."""
    seen = sample_shared_colors(read_reconstruction(folder / "sparse"), views)
    gains = estimate_gains(seen, len(views))
    return Exposure(gains.log_gains, gains.significant, _describe([view.camera.name for view in views], seen, gains))


def equalize_exposure(folder: Path, views: Sequence[View], exposure: Exposure) -> None:
    """Give the photos of a cameras folder the same exposure and white balance, in place, and write exposure.json beside them.

    Photos that are equal already stay the same bytes.

    Args:
        folder: with images/ of some of the views.
        views, exposure: those that the exposure was estimated of, and what it is.
    """
    there = [
        (folder / "images" / view.camera.name, *parts) for view, *parts in zip(views, exposure.log_gains, exposure.photos, strict=True)
    ]
    there = [one for one in there if one[0].is_file()]
    if exposure.corrected:

        def correct(path: Path, log_gain: np.ndarray) -> None:
            write_image(path, apply_gain(read_image(path), np.exp(log_gain)))

        map_in_threads(correct, [path for path, _, _ in there], [log_gain for _, log_gain, _ in there])
    record = {"corrected": exposure.corrected, "photos": [photo for _, _, photo in there]}
    write_json(folder / RECORD, record)
    _warn(record)


def apply_gain(image: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 sRGB, its linear light multiplied by a (3,) factor; what becomes brighter than white is cut off."""
    linear = srgb_to_linear(np.arange(256) / 255.0)[:, None] * gain
    table = np.rint(linear_to_srgb(np.minimum(linear, 1.0)) * 255.0).astype(np.uint8)
    return cv2.LUT(image, table[None])


def _describe(names: list[str], seen: SharedColors, gains: Gains) -> list[dict[str, Any]]:
    """Each photo's factors, as found even where none is applied."""
    points = np.bincount(seen.photo, minlength=len(names))
    clipped = np.bincount(seen.photo, seen.clipped, len(names)) / np.maximum(points, 1)
    return [
        {
            "name": name,
            "gains": [round(float(gain), 4) for gain in np.exp(log_gain)],
            "deviations": [round(float(value), 4) for value in deviation],
            "points": int(count),
            "clipped_share": round(float(share), 4),
        }
        for name, log_gain, deviation, count, share in zip(names, gains.log_gains, gains.deviations, points, clipped, strict=True)
    ]


def _warn(record: dict[str, Any]) -> None:
    """Warn of photos that correction cannot fully repair."""
    photos = record["photos"] if record["corrected"] else []
    extreme = [photo["name"] for photo in photos if max(max(photo["gains"]), 1 / min(photo["gains"])) > EXTREME_GAIN]
    if extreme:
        warn(
            f"exposure or white balance is far from that of the other photos in {', '.join(extreme)}; it is corrected, but overexposed and"
            " underexposed parts stay without detail. Lock exposure and white balance when you photograph"
        )
    clipped = [photo["name"] for photo in photos if photo["clipped_share"] > CLIPPED_SHARE]
    if clipped:
        warn(f"overexposed: {', '.join(clipped)}; expose these photos less")
