"""Pictures as the network takes them: 512 pixels along the long side, both sides multiples of 16."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.networks.mast3r.model import PATCH_PX
from zeroshop_steps.runtime.errors import StepError

LONG_SIDE_PX = 512  # what the published network was trained at


@dataclass(frozen=True)
class Framing:
    """How a picture was resized, then cropped about its middle; pixel (0, 0)'s centre is (0.5, 0.5) in both.

    Attributes:
        width_px, height_px: size for the network.
        scale: (2,) pixels of the network a pixel of the original, along x and y.
        offset_px: (2,) what was cropped at the left and at the top, in pixels of the network.
    """

    width_px: int
    height_px: int
    scale: tuple[float, float]
    offset_px: tuple[int, int]

    def to_original(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 2) positions in the network's picture to those in the original."""
        return (pixels + np.array(self.offset_px)) / np.array(self.scale)

    def from_original(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 2) positions in the original to those in the network's picture."""
        return pixels * np.array(self.scale) - np.array(self.offset_px)


def fit_framing(width_px: int, height_px: int, long_side_px: int = LONG_SIDE_PX) -> Framing:
    """How a picture of this size is resized and cropped.

    Raises:
        StepError: so long and narrow that less than a patch is left.
    """
    factor = long_side_px / max(width_px, height_px)
    resized = (round(width_px * factor), round(height_px * factor))
    kept = (resized[0] // PATCH_PX * PATCH_PX, resized[1] // PATCH_PX * PATCH_PX)
    if min(kept) == 0:
        raise StepError(f"a picture of {width_px} x {height_px} px is too narrow: {PATCH_PX} px are needed along its short side")
    offset = ((resized[0] - kept[0]) // 2, (resized[1] - kept[1]) // 2)
    return Framing(kept[0], kept[1], (resized[0] / width_px, resized[1] / height_px), offset)


def fit_framing_of_file(path: Path, long_side_px: int = LONG_SIDE_PX) -> Framing:
    """`fit_framing` a picture whose pixels are not read yet."""
    try:
        with Image.open(path) as opened:
            width, height = opened.size
    except OSError:
        height, width = read_image(path).shape[:2]  # says what is wrong with the file
    return fit_framing(width, height, long_side_px)


def load_picture(path: Path, long_side_px: int = LONG_SIDE_PX, mask: Path | None = None) -> tuple[torch.Tensor, Framing]:
    """Read a picture as (3, height, width) values from -1 to 1; it is resized as in the training, by Lanczos or bicubic filters.

    Where there is a mask, what lies outside of it becomes black.
    """
    pixels = read_image(path)
    height, width = pixels.shape[:2]
    if mask:
        pixels = pixels * read_mask(mask, (width, height))[..., None]
    framing = fit_framing(width, height, long_side_px)
    resized = (round(width * framing.scale[0]), round(height * framing.scale[1]))
    kind = Image.Resampling.LANCZOS if resized[0] < width else Image.Resampling.BICUBIC
    left, top = framing.offset_px
    box = (left, top, left + framing.width_px, top + framing.height_px)
    picture = np.asarray(Image.fromarray(pixels).resize(resized, kind).crop(box), np.float32)
    return torch.from_numpy(picture / 127.5 - 1.0).permute(2, 0, 1), framing
