"""A view whose mask is in memory."""

from dataclasses import dataclass

import numpy as np

from zeroshop_steps.geometry.registered_views import View


@dataclass(frozen=True)
class MaskedView(View):
    """A view with its (height, width) bool mask."""

    pixels: np.ndarray

    def mask(self) -> np.ndarray:
        return self.pixels
