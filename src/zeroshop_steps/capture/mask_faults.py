"""What is wrong with a user's masks: they are empty or full, mark the background, or cut the object off."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.capture.mask_files import UserMask
from zeroshop_steps.geometry.imaging.images import measure_border_share
from zeroshop_steps.runtime.errors import StepError

SMALLEST_SHARE, LARGEST_SHARE = 5e-4, 0.98  # of the image that a mask may cover; others are empty or full
INVERTED_BORDER = 0.75  # of the image's circumference that a mask marks, and of the photos in which it does, where masks are inverted
BORDER_SHARE, BORDER_PX = 0.005, 3  # of the image's circumference, and at least so many pixels, that a mask must touch to be cut off


def check_polarity(photos: Sequence[tuple[str, UserMask | None]], folder: Path) -> None:
    """Check that masks mark the object and not the background.

    Args:
        photos: the name and the mask of each.
        folder: where the masks lie.

    Raises:
        StepError: masks mark the border nearly all around in nearly all photos.
    """
    marked = [name for name, mask in photos if mask and measure_border_share(mask.pixels) > INVERTED_BORDER]
    if photos and len(marked) > INVERTED_BORDER * len(photos):
        raise StepError(
            f"the masks in {folder} mark the border of the photos nearly all around in {len(marked)} of {len(photos)} photos, such as"
            f" {marked[0]}: they seem inverted. Masks are white (255) on the object and black (0) elsewhere; invert them. If"
            " the object is that close, step back: it must fit into the photos"
        )


def find_mask_fault(mask: UserMask) -> str:
    """What is wrong with a mask, in words; nothing for a good one."""
    share = float(mask.pixels.mean())
    if share < SMALLEST_SHARE:
        how = "empty" if share == 0 else "almost empty"
        return f"mask {mask.path} is {how}: mark the object, brighter than the rest, or take the photo out"
    if share > LARGEST_SHARE:
        return f"mask {mask.path} is full: {share:.0%} of the image is marked. Mark only the object; it must fit into the photo."
    if measure_border_share(mask.pixels) > INVERTED_BORDER:
        return f"mask {mask.path} marks the border nearly all around: invert it, if it marks the background; else the object is too close"
    return ""


def is_cut_off(mask: np.ndarray) -> bool:
    """Whether a mask touches so much of the image's border that the object is cut off there."""
    return measure_border_share(mask) > max(BORDER_PX / (2 * sum(mask.shape)), BORDER_SHARE)
