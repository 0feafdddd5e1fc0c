"""Masks of everything in an image: Segment Anything (Kirillov et al. 2023), prompted at a grid of points as its authors describe."""

from pathlib import Path

import cv2
import numpy as np
import torch
from torch.nn import functional

from zeroshop_steps.bop.formats.detections import mask_to_box
from zeroshop_steps.detect.detector_io import suppress_boxes
from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.imagenet import LEVEL_DEVIATION, LEVEL_MEAN
from zeroshop_steps.networks.pretrained import load_pretrained

POINTS_AT_ONCE = 64  # prompts that go through the network at a time, which bounds its memory
STABILITY_OFFSET = 1.0  # of the logits, up and down, between which the mask of a stable region hardly changes
MOST_BOX_IOU = 0.7  # with more, the less confident mask is dropped
SMALLEST_BOX_SIDE, SMALLEST_MASK = 0.05, 3e-4  # shares of the image's side and area; CNOS drops smaller proposals


class SegmentAnything:
    """SAM on a device."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        """Read the model's folder. Raises StepError if one of its files is missing or damaged."""
        from transformers import SamModel

        self._model, self._device = load_pretrained(SamModel, folder, device), device
        self._side_px = self._model.config.vision_config.image_size

    def segment(self, image: np.ndarray, points_per_side: int, least_iou: float, least_stability: float) -> list[np.ndarray]:
        """Segment everything in an image.

        Args:
            image: (height, width, 3) uint8 RGB.
            points_per_side: of the grid of points; each gives three masks, of a part, a whole and a group.
            least_iou: masks with a lower predicted IoU are dropped.
            least_stability: masks with a lower `measure_stability` are dropped.

        Returns:
            (height, width) bool masks, the most confident first.

        Raises:
            StepError: out of memory.
        """
        with run_network(self._device, "SAM"):
            return self._segment(image, points_per_side, least_iou, least_stability)

    def _segment(self, image: np.ndarray, points_per_side: int, least_iou: float, least_stability: float) -> list[np.ndarray]:
        height, width = image.shape[:2]
        scale = self._side_px / max(height, width)
        inner = max(1, round(width * scale)), max(1, round(height * scale))
        pixels = np.zeros((self._side_px, self._side_px, 3), np.float32)
        pixels[: inner[1], : inner[0]] = (cv2.resize(image, inner, interpolation=cv2.INTER_LINEAR) - LEVEL_MEAN) / LEVEL_DEVIATION
        tensor = torch.from_numpy(pixels.transpose(2, 0, 1)[None].copy()).to(self._device)
        embeddings = self._model.get_image_embeddings(tensor)
        steps = (np.arange(points_per_side) + 0.5) / points_per_side
        points = np.stack(np.meshgrid(steps * inner[0], steps * inner[1]), -1).reshape(-1, 1, 2)
        found, surety = [], []
        for start in range(0, len(points), POINTS_AT_ONCE):
            some = torch.from_numpy(points[None, start : start + POINTS_AT_ONCE].astype(np.float32)).to(self._device)
            labels = torch.ones(some.shape[:3], dtype=torch.long, device=self._device)
            answer = self._model(input_points=some, input_labels=labels, image_embeddings=embeddings, multimask_output=True)
            predicted = answer.iou_scores.flatten().float()
            likely = predicted > least_iou
            logits = answer.pred_masks.flatten(0, 2)[likely].float()
            if not len(logits):
                continue
            logits = self._resize_to_image(logits, inner, (height, width))
            kept = measure_stability(logits) >= least_stability
            found += list((logits[kept] > 0).cpu().numpy())
            surety += predicted[likely][kept].tolist()
        return drop_duplicate_masks(found, np.array(surety))

    def _resize_to_image(self, logits: torch.Tensor, inner: tuple[int, int], size: tuple[int, int]) -> torch.Tensor:
        """(N, height, width) logits of the image's pixels from those of the padded square."""
        square = functional.interpolate(logits[:, None], (self._side_px, self._side_px), mode="bilinear", align_corners=False)
        return functional.interpolate(square[..., : inner[1], : inner[0]], size, mode="bilinear", align_corners=False)[:, 0]


def measure_stability(logits: torch.Tensor) -> torch.Tensor:
    """(N,) IoU of the masks thresholded one logit above and one below 0; 0 for empty ones."""
    inside, outside = (logits > STABILITY_OFFSET).sum((-1, -2)), (logits > -STABILITY_OFFSET).sum((-1, -2))
    return inside / outside.clamp(min=1)


def drop_duplicate_masks(masks: list[np.ndarray], surety: np.ndarray) -> list[np.ndarray]:
    """The masks that are not empty, the most confident first, without those with nearly the same box as a more confident one."""
    full = [index for index, mask in enumerate(masks) if mask.any()]
    if not full:
        return []
    boxes = np.array([mask_to_box(masks[index]) for index in full], float)
    return [masks[full[index]] for index in suppress_boxes(boxes, surety[full], MOST_BOX_IOU)]


def drop_small_masks(masks: list[np.ndarray]) -> list[np.ndarray]:
    """The masks without those with few pixels, or with a box smaller than a square of a twentieth of the image's sides."""
    kept = []
    for mask in masks:
        _, _, width, height = mask_to_box(mask)
        if width * height > SMALLEST_BOX_SIDE**2 * mask.size and mask.mean() > SMALLEST_MASK:
            kept.append(mask)
    return kept
