"""The network on a device: loading it, one pass over the frames, tracks from any of them."""

import contextlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from zeroshop_steps.networks.vggt.model import Vggt, list_matrices
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, load_strictly, resolve_weights
from zeroshop_steps.runtime.errors import StepError, is_out_of_memory
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.runtime.progress import ProgressReport

SIZES = ".settings.json"
Settings = TypeVar("Settings")


@dataclass(frozen=True)
class VggtOutput:
    """What a pass says of S frames.

    Attributes:
        encodings: (S, 9) cameras, `feed_forward.decode_cameras` reads them.
        depth, confidence: (S, height, width); confidence is at least 1.
    """

    encodings: np.ndarray
    depth: np.ndarray
    confidence: np.ndarray


def resolve_published(path: Path, published: Collection[str]) -> Path:
    """The weights at `path`, as `resolve_weights` gives them: one of the published ones, by their names below resources/weights, or own."""
    names = {WEIGHTS_FOLDER / name: name for name in published}
    return resolve_weights(path, names.get(path, next(iter(published))), SIZES)


def read_settings(weights: Path, published: Settings) -> Settings:
    """The sizes of the network: those published, or those in model.settings.json beside model.safetensors."""
    path = weights.with_suffix(SIZES)
    if not path.is_file():
        return published
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in read_json(path).items()}
    try:
        return type(published)(**values)
    except TypeError as error:
        raise StepError(f"{path} does not fit the network ({error}); delete it to use the published sizes") from None


class VggtNetwork:
    """VGGT with its weights on a device.

    Args:
        weights: file of a checkpoint.
        settings: its sizes.
        device: "cpu" or "cuda".
        precision: of the attention blocks.
        chunk: frames at a time in the dense heads.
    """

    def __init__(self, weights: Path, settings: VggtSettings, device: str, precision: torch.dtype, chunk: int) -> None:
        with torch.device("meta"):
            self.module = Vggt(settings)
        load_strictly(self.module, weights)
        if precision == torch.bfloat16:  # in which autocast calculates with them anyway
            for part in list_matrices(self.module):
                part.to(precision)
        with memory_errors():
            self.module.to(device).requires_grad_(False).eval()
        self.device, self.precision, self.chunk = device, precision, chunk
        self._first, self._size_px = -1, (0, 0)
        self._layers: list[torch.Tensor] = []

    def predict(self, pixels: np.ndarray) -> VggtOutput:
        """Cameras and depth of (S, 3, height, width) frames, in the frame of the first camera."""
        with torch.inference_mode(), memory_errors():
            layers = self._tokens(pixels, 0)
            chunks = -(-len(pixels) // self.chunk)
            with ProgressReport("depth (groups of frames)", chunks) as report:
                encodings, depth, confidence = self.module.cameras_and_depth(layers, self._size_px, self.chunk, report.advance)
            return VggtOutput(*(values.float().cpu().numpy() for values in (encodings, depth, confidence)))

    def track(self, pixels: np.ndarray, view: int, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Follow points of one view through all.

        The network follows points of the frame that comes first, so another view costs a pass of its own.

        Args:
            pixels: (S, 3, height, width) frames.
            view: where the points are.
            xy: (N, 2) pixel indices.

        Returns:
            (S, N, 2) pixel indices and (S, N) visibility from 0 to 1, in the order of the frames.
        """
        order = np.array([view, *(index for index in range(len(pixels)) if index != view)])
        with torch.inference_mode(), memory_errors():
            layers = self._tokens(pixels, view)
            tracks = self.module.track_head(layers, self._size_px, torch.from_numpy(xy).float().to(self.device), self.chunk)
            back = np.argsort(order)
            return tracks.xy.float().cpu().numpy()[back], tracks.visibility.float().cpu().numpy()[back]

    def _tokens(self, pixels: np.ndarray, view: int) -> list[torch.Tensor]:
        """The tokens of all frames, `view` first; kept until another view is asked for."""
        if self._first != view:
            self._layers = []
            order = [view, *(index for index in range(len(pixels)) if index != view)]
            images = torch.from_numpy(pixels[order]).to(self.device)
            with ProgressReport(f"attention (blocks), view {view + 1} first", self.module.settings.depth) as report:
                self._layers = self.module.tokens(images, self.precision, report.advance)
            self._first, self._size_px = view, (images.shape[2], images.shape[3])
        return self._layers


@contextlib.contextmanager
def memory_errors() -> Iterator[None]:
    """Turn PyTorch's errors about memory into one for the user, which is no result about the pictures."""
    try:
        yield
    except RuntimeError as error:
        if is_out_of_memory(error):
            raise StepError(
                "memory ran out in the network; take fewer images, or tracked points, close what else uses the device, or use "
                "--device cpu or the registration colmap"
            ) from MemoryError(str(error))
        raise
