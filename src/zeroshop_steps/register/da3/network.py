"""The network on a device: loading it, one pass over the images, and how much memory that takes."""

from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open

from zeroshop_steps.networks.da3.camera_tokens import invert_encodings
from zeroshop_steps.networks.da3.model import DepthAnything3, adapt_names
from zeroshop_steps.networks.da3.settings import BASE, SMALL, Da3Settings
from zeroshop_steps.networks.weights import load_strictly
from zeroshop_steps.register.vggt.memory import BASE_BYTES, DENSE_MAPS, TOKEN_WIDTHS, VALUE_BYTES
from zeroshop_steps.register.vggt.network import VggtOutput, memory_errors
from zeroshop_steps.runtime.progress import ProgressReport

WIDTH_OF = "cls_token"  # ends the name of a tensor whose last dimension is the width of a token


def find_size(weights: Path) -> Da3Settings:
    """The published size of a checkpoint, by the width of its tokens; small where that does not tell."""
    try:
        with safe_open(weights, "pt") as opened:
            widths = {opened.get_slice(name).get_shape()[-1] for name in opened.keys() if name.endswith(WIDTH_OF)}  # noqa: SIM118
    except SafetensorError:  # damaged, which loading it tells
        return SMALL
    return BASE if widths == {BASE.width} else SMALL


class Da3Network:
    """Depth Anything 3 with its weights on a device.

    Args:
        weights: file of a checkpoint.
        settings: its sizes.
        device: "cpu" or "cuda".
        precision: of the backbone.
        chunk: images at a time in the head.
    """

    def __init__(self, weights: Path, settings: Da3Settings, device: str, precision: torch.dtype, chunk: int) -> None:
        with torch.device("meta"):
            self.module = DepthAnything3(settings)
        load_strictly(self.module, weights, adapt_names)
        with memory_errors():
            self.module.to(device).requires_grad_(False).eval()
        self.device, self.precision, self.chunk = device, precision, chunk

    def predict(self, pixels: np.ndarray) -> VggtOutput:
        """Cameras and depth of (S, 3, height, width) images, in the frame of the reference camera."""
        with torch.inference_mode(), memory_errors():
            images = torch.from_numpy(pixels).to(self.device)
            with ProgressReport("attention (blocks)", self.module.settings.depth) as report:
                tokens = self.module.tokens(images, self.precision, after_block=report.advance)
            with ProgressReport("depth (groups of images)", -(-len(pixels) // self.chunk)) as report:
                found = self.module.cameras_and_depth(tokens, (images.shape[2], images.shape[3]), self.chunk, report.advance)
            encodings, depth, confidence = (values.float().cpu().numpy() for values in (invert_encodings(found[0]), *found[1:]))
            return VggtOutput(encodings, depth, confidence)


def predict_peak_bytes(settings: Da3Settings, weights_bytes: int, frames: int, size_px: tuple[int, int], chunk: int, half: bool) -> int:
    """The most memory that a run takes; the arguments are those of `register.vggt.memory.predict_peak_bytes`."""
    pixels = size_px[0] * size_px[1]
    tokens = frames * (pixels // settings.patch_px**2 + 1)
    kept = tokens * len(settings.layers) * 2 * settings.width
    attention = kept + tokens * settings.width * TOKEN_WIDTHS[half]
    dense = kept + min(chunk, frames) * pixels * settings.dense_features * DENSE_MAPS + 2 * frames * pixels
    return int(BASE_BYTES + weights_bytes + VALUE_BYTES * (max(attention, dense) + 3 * frames * pixels))
