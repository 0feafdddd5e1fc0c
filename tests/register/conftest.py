"""What the registration tests share."""

from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.geometry.imaging.images import write_image, write_mask


@pytest.fixture
def blank_capture(tmp_path) -> Path:
    """Ten pictures with a mask but with nothing to match in them."""
    for index in range(10):
        mask = np.zeros((120, 160), bool)
        mask[40:80, 50 : 100 + index] = True
        write_image(tmp_path / "images" / f"{index:06d}.png", np.where(mask, 200, 40).astype(np.uint8)[..., None].repeat(3, axis=2))
        write_mask(tmp_path / "masks" / f"{index:06d}.png", mask)
    return tmp_path
