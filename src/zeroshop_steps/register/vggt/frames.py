"""The pictures as the network wants them: of one small size, with the way back to the pixels of the files."""

from dataclasses import dataclass

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.register.scene.image_set import ImageSet, mask_files, read_masks


@dataclass(frozen=True)
class Frames:
    """Images scaled down to the network's size; for some networks upright ones get black at both sides, which makes them square.

    Attributes:
        names: image names.
        pixels: (S, 3, height, width) float32 RGB from 0 to 1.
        size_px: (width, height) of the images in the files.
        scale: (2,) network pixels a pixel of the file, in x and y.
        left_px: network pixels of black before the image begins.
    """

    names: tuple[str, ...]
    pixels: np.ndarray
    size_px: tuple[int, int]
    scale: np.ndarray
    left_px: int

    @property
    def network_size_px(self) -> tuple[int, int]:
        """(width, height) of what the network sees."""
        return self.pixels.shape[3], self.pixels.shape[2]

    def to_image(self, xy: np.ndarray) -> np.ndarray:
        """(..., 2) network pixel indices, first centre at 0, as positions in the file's image, first centre at 0.5."""
        return (xy + 0.5 - [self.left_px, 0.0]) / self.scale

    def to_network(self, xy: np.ndarray) -> np.ndarray:
        """The way back."""
        return xy * self.scale + [self.left_px, 0.0] - 0.5


def fit_size(size_px: tuple[int, int], image_px: int, patch_px: int, upright: bool = False) -> tuple[tuple[int, int], int]:
    """The (width, height) of an image of `size_px` for the network, and how much black goes to its left (and right).

    The longer side becomes `image_px`, the other the nearest multiple of `patch_px`. VGGT was trained on images that are wider than
    high, so upright ones are made square, unless the network takes `upright` ones.
    """
    longer = max(size_px)
    width, height = (max(patch_px, patch_px * round(image_px * side / longer / patch_px)) for side in size_px)
    return (width, height), (image_px - width) // 2 if height > width and not upright else 0


def read_frames(image_set: ImageSet, image_px: int, patch_px: int, object_only: bool = False, upright: bool = False) -> Frames:
    """Read all images of a set, which are of equal size (`ImageSet.size_px` refuses others); `upright` is that of `fit_size`.

    With `object_only` they are black outside the masks: the ground of photos in which the object was turned stood still.
    """
    (width, height), left = fit_size(image_set.size_px, image_px, patch_px, upright)
    shrinks = width <= image_set.size_px[0]
    pixels = np.zeros((len(image_set.images), 3, height, width + 2 * left), np.float32)
    masks = mask_files(image_set) if object_only else [None] * len(image_set.images)
    for row, path, mask in zip(pixels, image_set.images, masks, strict=True):
        original = read_image(path)
        if mask:
            original = original * read_mask(mask, image_set.size_px)[..., None]
        image = cv2.resize(original, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
        row[:, :, left : left + width] = image.transpose(2, 0, 1) / np.float32(255)
    scale = np.array([width / image_set.size_px[0], height / image_set.size_px[1]])
    return Frames(tuple(image_set.names), pixels, image_set.size_px, scale, left)


def find_usable_pixels(frames: Frames, image_set: ImageSet, object_only: bool) -> np.ndarray:
    """(S, height, width) bool: where points may come from. Not from the black sides, with `object_only` not from off the object."""
    width, height = frames.network_size_px
    usable = np.zeros((len(frames.names), height, width), bool)
    usable[:, :, frames.left_px : width - frames.left_px] = True
    if object_only:
        for row, mask in zip(usable, read_masks(image_set).values(), strict=True):
            small = cv2.resize(mask.astype(np.uint8), (width - 2 * frames.left_px, height), interpolation=cv2.INTER_AREA)
            row[:, frames.left_px : width - frames.left_px] = cv2.erode(small, np.ones((3, 3), np.uint8), borderValue=1) > 0
    return usable
