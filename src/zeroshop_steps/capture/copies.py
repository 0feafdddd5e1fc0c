"""Copies of one photo among others: the same file twice, or another encoding of it, sent by a messenger, reduced or converted."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from zeroshop_steps.capture.enlargements import is_enlarged
from zeroshop_steps.capture.frame_quality import is_copy, make_thumbnail
from zeroshop_steps.capture.photo_files import MAX_SIDE_PX, PhotoPixels, choose_suffix, read_photo

DETAIL_PX, BLOCK_PX = (128, 96), 8  # (width, height) of the pictures that are compared, and of the blocks in which they are
NOISE_LEVELS = 4.0  # of 255: blocks that vary less say nothing
LEAST_CORRELATION = 0.5
"""In each block of two encodings of a photo: 0.74 and more of JPEG at a quality of 10 or reduced to a quarter (five captures of photos);
at 3 or 5 it has 0.52 and more by the noise that is expected. Neighbouring frames of two films have up to 0.45, but for pairs while the
camera hardly moved, which have 0.9; neighbouring photos of four captures have up to 0.11, also compressed so."""
OTHER_STEP, OTHER_PIXELS = 2.0, 1.1
"""So many times as coarse a quantization, or as many pixels, and a photo was not saved as the other was: cameras keep to theirs."""
COMPARED_SIDE_PX = 2 * MAX_SIDE_PX  # at most, of two encodings of one photo: 85 MB
COLOURED_LEVELS = 2.0  # of 255: a grey picture's channels differ by no more, in the mean, for JPEG rounds them
T = TypeVar("T")


@dataclass(frozen=True)
class Encoding:
    """How a photo was saved, and what tells whether another file shows the same.

    Attributes:
        path: the file.
        stored_as: its format, as Pillow calls it.
        step: mean step of a JPEG's quantization, in levels; 0 for other formats.
        noise: variance that the quantization leaves in `details`, in levels squared.
        pixels: their number.
        file_bytes: size of the file.
        lossless: whether nothing was lost in it.
        coloured: whether it has colours.
        thumbnail: as `make_thumbnail` gives it.
        details: (96, 128) uint8 grey picture.
    """

    path: Path
    stored_as: str
    step: float
    noise: float
    pixels: int
    file_bytes: int
    lossless: bool
    coloured: bool
    thumbnail: np.ndarray
    details: np.ndarray

    @property
    def stem(self) -> str:
        """The file's name, without its suffix and the case of its letters."""
        return self.path.stem.casefold()

    @property
    def rank(self) -> tuple[bool, int, bool, int]:
        """Of encodings of one photo, the largest is the best: more bytes keep more, where they hold as many pixels."""
        return self.coloured, self.pixels, self.lossless, self.file_bytes

    def differs_from(self, other: "Encoding") -> bool:
        """Whether two files were not saved in one way, as photos of one camera are."""
        (fine, coarse), (few, many) = sorted([self.step, other.step]), sorted([self.pixels, other.pixels])
        return self.stored_as != other.stored_as or many > OTHER_PIXELS * few or coarse > OTHER_STEP * fine

    def shows_as(self, other: "Encoding") -> bool:
        """Whether two files are of one photo, or of two that show the same to the last pixel."""
        if is_copy(self.thumbnail, other.thumbnail):
            return True
        if self.stem != other.stem and not self.differs_from(other):
            return False
        return _correlate(self.details, other.details, self.noise + other.noise) >= LEAST_CORRELATION

    def holds(self, other: "Encoding") -> bool:
        """Whether another encoding of the photo is larger, but shows no more than this one."""
        if self.coloured < other.coloured or other.pixels <= OTHER_PIXELS * self.pixels:
            return False
        return is_enlarged(*(read_photo(one.path, COMPARED_SIDE_PX) for one in (other, self)))


def describe_encoding(path: Path, photo: PhotoPixels) -> Encoding:
    """How a photo was saved in a file that was just read."""
    small = cv2.resize(photo.pixels, DETAIL_PX, interpolation=cv2.INTER_AREA)
    return Encoding(
        path,
        photo.stored_as,
        float(np.mean(photo.quantization or 0)),
        _find_noise(photo),
        math.prod(photo.stored_px),
        path.stat().st_size,
        choose_suffix(path) == ".png",
        float(np.ptp(small.astype(np.float32), axis=2).mean()) > COLOURED_LEVELS,
        make_thumbnail(photo.pixels),
        cv2.cvtColor(small, cv2.COLOR_RGB2GRAY),
    )


def find_twins(files: Sequence[T], alike: Callable[[T, T], bool]) -> dict[int, int]:
    """The numbers of the files that are like one before, and the number of that."""
    twins: dict[int, int] = {}
    for number, file in enumerate(files):
        before = (other for other in range(number) if other not in twins and alike(file, files[other]))
        if (twin := next(before, None)) is not None:
            twins[number] = twin
    return twins


def find_worse_copies(encodings: Sequence[Encoding]) -> dict[int, int]:
    """The numbers of the files of whose photo there is a better encoding, and the number of the best."""
    groups: dict[int, list[int]] = {}
    for number, twin in find_twins(encodings, Encoding.shows_as).items():
        groups.setdefault(twin, [twin]).append(number)
    best = [_choose_best(group, encodings) for group in groups.values()]
    return {number: kept for kept, group in zip(best, groups.values(), strict=True) for number in group if number != kept}


def _choose_best(group: Sequence[int], encodings: Sequence[Encoding]) -> int:
    """The number of the best encoding of one photo: none that a smaller one was enlarged to."""
    ranked = sorted(group, key=lambda number: encodings[number].rank, reverse=True)
    return next(best for best in ranked if not any(encodings[other].holds(encodings[best]) for other in group))


def _find_noise(photo: PhotoPixels) -> float:
    """Variance that a JPEG's quantization leaves in the small picture of its details, in levels squared.

    A coefficient is off by up to half a step, evenly; the mean of several blocks, or of a part of one, keeps the coarse ones alone.
    """
    if not photo.quantization:
        return 0.0
    cell = max(photo.stored_px) / max(DETAIL_PX) / 8  # blocks that a pixel of the small picture covers, along its side
    coarse = math.ceil(min(8.0, max(1.0, 1 / cell)))
    steps = np.reshape(photo.quantization, (8, 8))[:coarse, :coarse].astype(np.float64)
    return float((steps**2).sum() / 12 / 64 * min(1.0, 1 / cell**2))


def _correlate(one: np.ndarray, other: np.ndarray, variance: float) -> float:
    """The least correlation of the blocks of two (96, 128) grey pictures, whose noise has this variance besides the usual one.

    Blocks without more contrast count as alike.
    """
    first, second = (_split(picture) for picture in (one, other))
    noise = NOISE_LEVELS**2 + variance
    common = (first * second).mean(1)
    spread = np.sqrt((first**2).mean(1) * (second**2).mean(1))
    return float(((common + noise) / (spread + noise)).min())


def _split(picture: np.ndarray) -> np.ndarray:
    """(B, 64) levels of each block of a (96, 128) picture, about the mean of what lies around."""
    height, width = picture.shape
    contrast = picture.astype(np.float32) - cv2.GaussianBlur(picture.astype(np.float32), (0, 0), BLOCK_PX)
    blocks = contrast.reshape(height // BLOCK_PX, BLOCK_PX, width // BLOCK_PX, BLOCK_PX)
    return np.asarray(blocks.transpose(0, 2, 1, 3).reshape(-1, BLOCK_PX**2))
