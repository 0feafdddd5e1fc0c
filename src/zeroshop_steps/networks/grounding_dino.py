"""Find the object that a few words describe, by Grounding DINO (Liu et al. 2024) from the transformers library."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.pretrained import load_part, load_pretrained
from zeroshop_steps.networks.weights import SHOWN
from zeroshop_steps.runtime.errors import StepError

OFF_MIDDLE = 0.5
"""The score of a box falls to 1/e where its centre is this share of half the image's diagonal away from the middle."""
WHOLE_SHARE = 0.9
"""A box wider and higher than this share of the image is the whole scene, not an object in it."""


@dataclass(frozen=True)
class Box:
    """A detection.

    Attributes:
        corners_px: left, top, right, bottom.
        score: 0 to 1, how well it fits the words.
    """

    corners_px: tuple[float, float, float, float]
    score: float

    def centrality(self, size_px: tuple[int, int]) -> float:
        """1 for a box in the middle of an image of (width, height), falling off towards its border."""
        left, top, right, bottom = self.corners_px
        off = np.hypot((left + right) / 2 - size_px[0] / 2, (top + bottom) / 2 - size_px[1] / 2)
        return float(np.exp(-((off / (OFF_MIDDLE * np.hypot(*size_px) / 2)) ** 2)))

    def is_whole(self, size_px: tuple[int, int]) -> bool:
        """Whether it holds nearly all of an image of (width, height)."""
        left, top, right, bottom = self.corners_px
        return right - left > WHOLE_SHARE * size_px[0] and bottom - top > WHOLE_SHARE * size_px[1]

    def overlap(self, other: tuple[float, float, float, float]) -> float:
        """Intersection over union with other corners."""
        low, high = np.maximum(self.corners_px[:2], other[:2]), np.minimum(self.corners_px[2:], other[2:])
        shared = float(np.prod(np.clip(high - low, 0, None)))
        areas = [float((box[2] - box[0]) * (box[3] - box[1])) for box in (self.corners_px, other)]
        return shared / max(sum(areas) - shared, 1e-9)

    def __str__(self) -> str:
        left, top, right, bottom = (round(value) for value in self.corners_px)
        return f"x {left} to {right}, y {top} to {bottom} (score {self.score:.2f})"


class Detector:
    """Grounding DINO on a device."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        """Read the model's folder.

        Raises:
            StepError: one of its files is missing or damaged.
        """
        from transformers import AutoTokenizer, GroundingDinoForObjectDetection, GroundingDinoImageProcessorPil

        # The processor that needs no torchvision.
        self._images = load_part(GroundingDinoImageProcessorPil, folder, "preprocessor_config.json")
        self._words = load_part(AutoTokenizer, folder, "tokenizer.json", "tokenizer_config.json")
        self._model = load_pretrained(GroundingDinoForObjectDetection, folder, device)
        self._device = device

    def detect(self, image: np.ndarray, prompt: str) -> list[Box]:
        """All boxes in an (H, W, 3) uint8 RGB image, the best first, however low their score.

        Raises:
            StepError: out of memory.
        """
        size_px = (image.shape[1], image.shape[0])
        words = self._words(_to_sentence(prompt), return_tensors="pt", return_token_type_ids=True)
        inputs = {**self._images(images=image, return_tensors="pt"), **words}
        with run_network(self._device, "Grounding DINO", "float32"):  # each layer moves the boxes of the one before a little
            outputs = self._model(**{name: value.to(self._device) for name, value in inputs.items()})
        [found] = self._images.post_process_object_detection(outputs, threshold=0.0, target_sizes=[(size_px[1], size_px[0])])
        limits = np.array([*size_px, *size_px], float)
        corners = np.clip(found["boxes"].float().cpu().numpy(), 0, limits)
        scores = found["scores"].float().cpu().tolist()
        boxes = [Box((x0, y0, x1, y1), score) for (x0, y0, x1, y1), score in zip(corners.tolist(), scores, strict=True)]
        boxes = [box for box in boxes if box.corners_px[2] - box.corners_px[0] >= 2 and box.corners_px[3] - box.corners_px[1] >= 2]
        return sorted(boxes, key=lambda box: (-box.score, box.corners_px))


def choose_box(
    boxes: list[Box], size_px: tuple[int, int], min_score: float, expected_px: tuple[float, float, float, float] | None = None
) -> Box | None:
    """The box with the highest score times centrality, or times the overlap with the expected box; None if there is none.

    Args:
        boxes: detections.
        size_px: (width, height) of the image.
        min_score: lower ones do not count.
        expected_px: corners of the box that the other images predict.
    """

    def value(box: Box) -> float:
        return box.score * (box.centrality(size_px) if expected_px is None else box.overlap(expected_px))

    able = [box for box in boxes if box.score >= min_score and not box.is_whole(size_px) and value(box) > 0]
    return max(able, key=value, default=None)


def describe_nothing_found(seen: dict[str, list[Box]], prompt: str, min_score: float, size_px: tuple[int, int]) -> StepError:
    """The error where no image shows the object, with the best boxes seen in each, by image name."""
    lines = []
    for name, boxes in seen.items():
        shown = [f"{box}{', nearly the whole image' if box.is_whole(size_px) else ''}" for box in boxes[:SHOWN]]
        lines.append(f"{name}: {'; '.join(shown) or 'no box at all'}")
    return StepError(
        f'nothing was found that is "{prompt}": no box reaches the score {min_score:g}. Say what the object is in the column prompt of '
        'objects.tsv ("a red mug."), show it whole in the middle of the first picture, or use segmentation: support_plane. '
        f"Boxes seen: {' | '.join(lines)}"
    )


def _to_sentence(prompt: str) -> str:
    """The words as the network was trained on them: lower case, with a full stop."""
    words = prompt.strip().lower()
    return words if words.endswith(".") else f"{words}."
