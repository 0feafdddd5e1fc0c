"""Whether a picture is a smaller one enlarged: with more pixels, but no more detail.

The larger one is forged from the smaller: enlarged by the usual interpolations, mixed so that they come nearest, and saved as the larger
was. Where the larger differs from that by no more than its own compression and rounding explain, it shows nothing that the smaller lacks.
"""

import io

import numpy as np
from PIL import Image

from zeroshop_steps.capture.photo_files import PhotoPixels

INTERPOLATIONS = (Image.Resampling.NEAREST, Image.Resampling.BILINEAR, Image.Resampling.BICUBIC, Image.Resampling.LANCZOS)
WINDOW_PX, WINDOWS = 64, 8  # side of the windows that are compared, of whole JPEG blocks, and how many lie along each side of the picture
ROUNDING = 0.2  # variance in levels squared, of roundings to whole levels: two of grey and one of colours
SPREAD = 1.5  # variances may be so many times what is expected, and those of a single window by the square of that


def is_enlarged(larger: PhotoPixels, smaller: PhotoPixels) -> bool:
    """Whether all that the larger of two upright pictures of one photo shows is in the smaller one, too."""
    height, width = larger.pixels.shape[:2]
    grey, small = (Image.fromarray(photo.pixels).convert("L") for photo in (larger, smaller))
    side = min(WINDOW_PX, *(edge // 8 * 8 for edge in (height, width)))
    corners = [
        (int(left) // 8 * 8, int(top) // 8 * 8)
        for top in np.linspace(0, height - side, WINDOWS)
        for left in np.linspace(0, width - side, WINDOWS)
    ]
    shown = np.concatenate([np.asarray(grey.crop((left, top, left + side, top + side))) for left, top in corners]).astype(np.float64)
    across, down = small.width / width, small.height / height
    boxes = [(left * across, top * down, (left + side) * across, (top + side) * down) for left, top in corners]
    enlarged = [np.concatenate([np.asarray(small.resize((side, side), how, box)) for box in boxes]).ravel() for how in INTERPOLATIONS]
    mixed = np.stack([*enlarged, np.ones(shown.size)], axis=1).astype(np.float64)
    forged = np.clip(mixed @ np.linalg.lstsq(mixed, shown.ravel(), rcond=None)[0], 0, 255).reshape(shown.shape)
    left, lost = (((picture - forged) ** 2).reshape(len(corners), -1).mean(1) for picture in (shown, _save_as(larger, forged)))
    expected = lost + ROUNDING
    return bool(np.all(left <= SPREAD**2 * expected) and left.mean() <= SPREAD * expected.mean())


def _save_as(photo: PhotoPixels, levels: np.ndarray) -> np.ndarray:
    """(H, W) grey levels after they were saved as a photo was; as they are, where its format is no JPEG."""
    if not photo.quantization:
        return levels
    buffer = io.BytesIO()
    Image.fromarray(np.rint(levels).astype(np.uint8)).save(buffer, "JPEG", qtables={0: list(photo.quantization)})
    return np.asarray(Image.open(buffer)).astype(np.float64)
