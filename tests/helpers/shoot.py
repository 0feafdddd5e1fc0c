"""A folder of photos and one of masks that a test can spoil."""

import functools
from pathlib import Path

import cv2
import numpy as np
import pytest

from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import compute_overlap, read_mask
from zeroshop_steps.runtime.errors import StepError

WIDTH, HEIGHT = 160, 120


@functools.cache
def encode_photo(index: int) -> bytes:
    """The JPEG of a photo of blocks."""
    blocks = np.random.default_rng(index).integers(0, 255, (HEIGHT // 10, WIDTH // 10, 3), dtype=np.uint8)
    image = cv2.resize(blocks, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes()


class Shoot:
    """A folder of photos and one of masks that a test can spoil."""

    def __init__(self, root: Path, count: int) -> None:
        self.images, self.masks, self.out = root / "photos", root / "masks", root / "capture"
        self.images.mkdir()
        self.masks.mkdir()
        mask = cv2.imencode(".png", self.disk().astype(np.uint8) * 255)[1].tobytes()
        for index in range(count):
            self.image(index).write_bytes(encode_photo(index))
            self.mask(index).write_bytes(mask)

    def image(self, index: int) -> Path:
        return self.images / f"IMG_{index:04d}.jpg"

    def mask(self, index: int) -> Path:
        return self.masks / f"IMG_{index:04d}.png"

    @staticmethod
    def disk(x: int = 80, y: int = 60) -> np.ndarray:
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        return (columns - x) ** 2 + (rows - y) ** 2 < 40**2

    def take(self, min_images: int = 8) -> None:
        import_photos(self.images, self.masks, min_images, self.out)

    def refused(self, **options) -> str:
        """The message of the error; nothing may be left behind, and the originals must be untouched."""
        before = {path: path.read_bytes() for folder in (self.images, self.masks) for path in folder.iterdir()}
        with pytest.raises(StepError) as error:
            self.take(**options)
        assert not self.out.exists() and not list(self.out.parent.glob(".capture*"))
        assert before == {path: path.read_bytes() for folder in (self.images, self.masks) for path in folder.iterdir()}
        return str(error.value)


def taken(shoot: Shoot) -> float:
    """The least overlap of the masks that were taken with the disk."""
    shoot.take(min_images=9)
    return min(compute_overlap(read_mask(path), shoot.disk()) for path in sorted((shoot.out / "masks").iterdir()))
