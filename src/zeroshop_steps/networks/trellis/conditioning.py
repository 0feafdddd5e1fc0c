"""Pictures as the flows see them: the object in the middle of a black square, as tokens of DINOv2 with registers (Darcet et al. 2024)."""

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.networks.pretrained import load_pretrained

MARGIN = 1.2
"""Side of the square, in longer sides of the mask's box."""


def frame_object(image: np.ndarray, mask: np.ndarray, size_px: int) -> np.ndarray:
    """(size, size, 3) uint8: the object alone, in the middle.

    Args:
        image: (H, W, 3) uint8 sRGB.
        mask: (H, W) bool, not empty.
        size_px: side of the square.
    """
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    side = int(max(rows[-1] - rows[0], columns[-1] - columns[0]) * MARGIN)
    top, left = (round((ends[0] + ends[-1]) / 2 - side // 2) for ends in (rows, columns))
    side = max(2 * (side // 2), 2)
    cut = np.zeros((side, side, 4), np.uint8)
    first, last = np.maximum((top, left), 0), np.minimum((top + side, left + side), mask.shape)
    window = slice(first[0], last[0]), slice(first[1], last[1])
    inside = slice(first[0] - top, last[0] - top), slice(first[1] - left, last[1] - left)
    cut[inside] = np.dstack([image[window], 255 * mask[window].astype(np.uint8)])
    # Pillow filters colours weighed by their opacity, so nothing of the background reaches the border.
    resized = np.asarray(Image.fromarray(cut).resize((size_px, size_px), Image.Resampling.LANCZOS)).astype(np.float32)
    return (resized[..., :3] * resized[..., 3:] / 255.0).astype(np.uint8)


class ImageEncoder:
    """DINOv2 from a folder of its files on a device."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        from transformers import Dinov2WithRegistersModel

        self.model = load_pretrained(Dinov2WithRegistersModel, folder, device)
        self.device = device

    def __call__(self, picture: np.ndarray) -> Tensor:
        """(T, width) tokens of a (size, size, 3) uint8 picture: class, registers and patches before the last norm, each normalised."""
        color = torch.from_numpy(picture).to(self.device).float().permute(2, 0, 1)[None] / 255.0
        mean, std = (torch.tensor(values, device=self.device)[None, :, None, None] for values in (MEAN, DEVIATION))
        tokens = self.model(pixel_values=(color - mean) / std, output_hidden_states=True).hidden_states[-1][0]
        return F.layer_norm(tokens.float(), tokens.shape[-1:])
