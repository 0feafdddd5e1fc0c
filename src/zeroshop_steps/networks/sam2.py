"""Follow an object through images from boxes in some of them, by SAM 2 (Ravi et al. 2024) from the transformers library."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch.nn.functional import interpolate

from zeroshop_steps.networks.devices import run_network
from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.networks.pretrained import load_pretrained
from zeroshop_steps.runtime.progress import ProgressReport

OBJECT = 1  # the one object of a session
TOP_LEFT, BOTTOM_RIGHT = 2, 3  # how the network's prompts name the corners of a box
NOT_KEPT = "high_res_masks"  # one for each image, of the network's input size: large, and not used again


@dataclass(frozen=True)
class TrackedMask:
    """The object in one image.

    Attributes:
        mask: (H, W) bool of the picture's size.
        score: log odds that the object is in the picture at all.
    """

    mask: np.ndarray
    score: float


class ObjectTracker:
    """SAM 2 on a device."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        """Read the model's folder.

        Raises:
            StepError: model.safetensors or config.json is missing or damaged.
        """
        from transformers import Sam2VideoModel

        self._model = load_pretrained(Sam2VideoModel, folder, device)
        size = self._model.config.image_size
        self._side_px = int(size if isinstance(size, int) else size[0])
        self._device = device

    def follow(
        self, read: Callable[[int], np.ndarray], count: int, size_px: tuple[int, int], boxes: Mapping[int, tuple[float, ...]]
    ) -> list[TrackedMask]:
        """Masks of all pictures.

        Args:
            read: the (H, W, 3) uint8 RGB picture of a number; they are read when needed and not kept.
            count: number of pictures, in the order in which they were taken.
            size_px: (width, height) of all.
            boxes: {picture: left, top, right, bottom in pixels}, at least one. From the first of them on forwards, then backwards.
        """
        session = self._session(read, count)
        found: dict[int, TrackedMask] = {}
        start = min(boxes)
        with run_network(self._device, "SAM 2"), ProgressReport("masks", count) as report:

            def step(number: int, reverse: bool) -> None:
                if number not in found:
                    report.advance()
                found[number] = self._tracked(self._model(session, frame_idx=number, reverse=reverse), size_px)

            for number, box in sorted(boxes.items()):
                self._add_box(session, number, box, size_px)
                step(number, False)
            for number in range(start + 1, count):
                step(number, False)
            for number in range(start - 1, -1, -1):
                step(number, True)
        return [found[number] for number in range(count)]

    def _session(self, read: Callable[[int], np.ndarray], count: int) -> Any:
        """A session that prepares pictures when they are needed, so that memory does not grow with their number."""
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        prepare, device = self._prepared, self._device

        class Session(Sam2VideoInferenceSession):
            @property
            def num_frames(self) -> int:
                return count

            def get_frame(self, frame_idx: int) -> torch.Tensor:
                return prepare(read(frame_idx)).to(device)

            def store_output(
                self, obj_idx: int, frame_idx: int, output_key: Any = None, output_value: Any = None, is_conditioning_frame: bool = True
            ) -> None:
                if output_key != NOT_KEPT:
                    super().store_output(obj_idx, frame_idx, output_key, output_value, is_conditioning_frame)

        session = Session(inference_device=device, inference_state_device=device, dtype=torch.float32)
        session.obj_id_to_idx(OBJECT)
        return session

    def _add_box(self, session: Any, number: int, box: tuple[float, ...], size_px: tuple[int, int]) -> None:
        corners = torch.tensor(box, dtype=torch.float32).view(1, 1, 2, 2) * (self._side_px / torch.tensor(size_px))
        labels = torch.tensor([TOP_LEFT, BOTTOM_RIGHT], dtype=torch.int32).view(1, 1, 2)
        session.add_point_inputs(session.obj_id_to_idx(OBJECT), number, {"point_coords": corners, "point_labels": labels})
        session.obj_with_new_inputs = [OBJECT]

    def _prepared(self, image: np.ndarray) -> torch.Tensor:
        """(3, S, S) float32 of an (H, W, 3) uint8 RGB picture, as the network was trained on them."""
        small = Image.fromarray(image).resize((self._side_px, self._side_px), Image.Resampling.BILINEAR)
        mean, deviation = (torch.tensor(values).view(3, 1, 1) for values in (MEAN, DEVIATION))
        return (torch.from_numpy(np.array(small)).permute(2, 0, 1).float() / 255.0 - mean) / deviation

    def _tracked(self, output: Any, size_px: tuple[int, int]) -> TrackedMask:
        logits = interpolate(output.pred_masks.float().view(1, 1, *output.pred_masks.shape[-2:]), (size_px[1], size_px[0]), mode="bilinear")
        return TrackedMask((logits[0, 0] > 0).cpu().numpy(), float(output.object_score_logits.float().max()))
