"""A folder of photos and one of masks that a test can spoil."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import write_image, write_mask
from zeroshop_steps.runtime.errors import StepError

WIDTH, HEIGHT = 160, 120


class Shoot:
    """A folder of photos and one of masks that a test can spoil."""

    def __init__(self, root: Path, count: int) -> None:
        self.images, self.masks, self.out = root / "photos", root / "masks", root / "capture"
        self.images.mkdir()
        for index in range(count):
            rng = np.random.default_rng(index)
            blocks = rng.integers(0, 255, (HEIGHT // 10, WIDTH // 10, 3), dtype=np.uint8)
            write_image(self.image(index), cv2.resize(blocks, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST))
            write_mask(self.mask(index), self.disk())

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
