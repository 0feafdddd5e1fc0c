"""Descriptors of masked crops: the class token of DINOv2 (Oquab et al. 2023)."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from zeroshop_steps.bop.detections import mask_to_box
from zeroshop_steps.networks.pretrained import load_pretrained

SIDE_PX, CROPS_AT_ONCE = 224, 16  # DINOv2's usual input; so many crops go through the network at a time, which bounds its memory
MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])  # ImageNet's, of 0..1


class CropDescriber:
    """Describes crops by DINOv2 on a device."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        """Read the model's folder. Raises StepError if one of its files is missing or damaged."""
        from transformers import Dinov2Model

        self._model, self._device = load_pretrained(Dinov2Model, folder, device), device

    @torch.inference_mode()
    def describe(self, regions: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """(N, D) float32 unit vectors of regions, each an image (height, width, 3) uint8 and a mask that is not empty."""
        vectors = []
        for start in range(0, len(regions), CROPS_AT_ONCE):
            crops = np.stack([crop_masked(image, mask) for image, mask in regions[start : start + CROPS_AT_ONCE]])
            tokens = self._model(torch.from_numpy(crops).to(self._device)).last_hidden_state[:, 0]
            vectors.append(torch.nn.functional.normalize(tokens, dim=1).cpu().numpy())
        return np.concatenate(vectors).astype(np.float32)


def crop_masked(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(3, SIDE_PX, SIDE_PX) float32: the box around the mask, black outside the mask, centred in a square, normalised."""
    left, top, width, height = mask_to_box(mask)
    window = np.s_[top : top + height, left : left + width]
    crop = image[window] * mask[window][..., None]
    scale = SIDE_PX / max(width, height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    crop = cv2.resize(crop, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    square = np.zeros((SIDE_PX, SIDE_PX, 3), np.uint8)
    x, y = (SIDE_PX - size[0]) // 2, (SIDE_PX - size[1]) // 2
    square[y : y + size[1], x : x + size[0]] = crop
    return ((square / 255 - MEAN) / DEVIATION).astype(np.float32).transpose(2, 0, 1)
