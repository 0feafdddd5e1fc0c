"""A view whose mask and pixels are in memory."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.cameras.registered_views import View


@dataclass(frozen=True)
class MemoryView(View):
    """A view with its (height, width) bool mask and its (height, width, 3) uint8 sRGB pixels, which are read from its file otherwise."""

    silhouette: np.ndarray
    pixels: np.ndarray | None = None

    def image(self) -> np.ndarray:
        return super().image() if self.pixels is None else self.pixels

    def mask(self) -> np.ndarray:
        return self.silhouette
