"""Descriptors of masked crops: the class token and the patch tokens of DINOv2 (Oquab et al. 2023)."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from zeroshop_steps.bop.formats.detections import mask_to_box
from zeroshop_steps.geometry.cameras.transforms import make_unit
from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.networks.pretrained import load_pretrained

SIDE_PX, CROPS_AT_ONCE = 224, 16  # DINOv2's usual input; so many crops go through the network at a time, which bounds its memory


class CropDescriber:
    """Describes crops by DINOv2 on a device."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        """Read the model's folder. Raises StepError if one of its files is missing or damaged."""
        from transformers import Dinov2Model

        self._model, self._device = load_pretrained(Dinov2Model, folder, device), device

    def describe(self, regions: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """(N, D) float32 unit vectors of regions, each an image (height, width, 3) uint8 and a mask that is not empty."""
        return np.concatenate([make_unit(tokens[:, 0]) for tokens, _ in self._run(regions)]).astype(np.float32)

    def describe_patches(self, regions: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """What `describe` gives, and (N, P, D) float32 unit vectors of the crops' patches, 0 for those of which the mask covers less
        than half."""
        wholes, patches = [], []
        for tokens, masks in self._run(regions):
            wholes.append(make_unit(tokens[:, 0]))
            patches.append(make_unit(tokens[:, 1:]) * cover_patches(masks, tokens.shape[1] - 1)[..., None])
        return np.concatenate(wholes).astype(np.float32), np.concatenate(patches).astype(np.float32)

    def _run(self, regions: Sequence[tuple[np.ndarray, np.ndarray]]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """(n, 1 + P, D) tokens and (n, SIDE_PX, SIDE_PX) masks, 0..255, of some regions after the other."""
        for start in range(0, len(regions), CROPS_AT_ONCE):
            some = regions[start : start + CROPS_AT_ONCE]
            crops = torch.from_numpy(np.stack([crop_masked(image, mask) for image, mask in some]))
            with run_network(self._device, "DINOv2"):
                tokens = self._model(crops.to(self._device)).last_hidden_state.float().cpu().numpy()
            yield tokens, np.stack([cut_square(mask.astype(np.uint8) * 255, mask) for _, mask in some])


def crop_masked(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(3, SIDE_PX, SIDE_PX) float32: the box around the mask, black outside the mask, centred in a square, normalised."""
    square = cut_square(image * mask[..., None], mask)
    return ((square / 255 - MEAN) / DEVIATION).astype(np.float32).transpose(2, 0, 1)


def cut_square(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(SIDE_PX, SIDE_PX, ...) of an image (height, width, ...): the box around the mask, as large as fits, in the middle of zeros."""
    left, top, width, height = mask_to_box(mask)
    scale = SIDE_PX / max(width, height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    crop = image[top : top + height, left : left + width]
    crop = cv2.resize(crop, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    square = np.zeros((SIDE_PX, SIDE_PX, *crop.shape[2:]), crop.dtype)
    x, y = (SIDE_PX - size[0]) // 2, (SIDE_PX - size[1]) // 2
    square[y : y + size[1], x : x + size[0]] = crop
    return square


def cover_patches(masks: np.ndarray, patches: int) -> np.ndarray:
    """(N, patches) bool: which of the patches, row by row, (N, SIDE_PX, SIDE_PX) masks of 0..255 cover by more than half."""
    side = math.isqrt(patches)
    step = SIDE_PX // side
    return masks[:, : side * step, : side * step].reshape(-1, side, step, side, step).mean((2, 4)).reshape(-1, patches) > 127.5
