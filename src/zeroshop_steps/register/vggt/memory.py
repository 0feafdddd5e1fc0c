"""Networks that see all images at once: how much memory a run will need, said before they are loaded."""

import argparse
import functools
import os
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import torch

from zeroshop_steps.networks.devices import choose_device, choose_precision, measure_free_bytes
from zeroshop_steps.networks.vggt.model import Vggt, list_matrices
from zeroshop_steps.networks.vggt.settings import VggtSettings
from zeroshop_steps.networks.vggt.track_head import VOLUME_VALUES
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.runtime.errors import StepError

CHUNKS = {"cpu": (1,), "cuda": (8, 4, 2, 1)}
"""Images at a time in the dense heads, the first that fits: on the processor more than one only costs memory."""
VALUE_BYTES = torch.float32.itemsize
BASE_BYTES = 600_000_000  # Python and PyTorch themselves
TOKEN_WIDTHS = {False: 18, True: 14}
"""Values of a token that are alive at once in a block, as a multiple of the token's width, and where bfloat16 is used; measured."""
DENSE_MAPS = 3.2  # the same for a dense head, as a multiple of `features` at each pixel of the image; measured
TRACK_WIDTHS = 14  # the same for the tracker's tokens; measured


def predict_peak_bytes(
    settings: VggtSettings, weights_bytes: int, frames: int, size_px: tuple[int, int], points: int, chunk: int, half: bool = False
) -> int:
    """The most memory that a run takes.

    Args:
        settings: sizes of the network.
        weights_bytes: size of the file of weights.
        frames: number of images.
        size_px: (width, height) of what the network sees.
        points: tracked points of a view; 0 without tracks.
        chunk: frames at a time in the dense heads.
        half: whether the attention is in bfloat16, and its weights are held so.
    """
    pixels = size_px[0] * size_px[1]
    tokens = frames * (pixels // settings.patch_px**2 + 1 + settings.registers)
    kept = tokens * len(settings.layers) * 2 * settings.width
    attention = kept + tokens * settings.width * TOKEN_WIDTHS[half]
    dense = kept + min(chunk, frames) * pixels * settings.dense_features * DENSE_MAPS + 4 * frames * pixels
    maps = frames * pixels / settings.track_stride**2 * settings.track_features
    follow = kept + 3 * maps + 2 * VOLUME_VALUES + TRACK_WIDTHS * frames * (points + settings.virtual_tracks) * settings.track_width
    values = max(attention, dense, follow if points else 0) + 3 * frames * pixels
    return int(BASE_BYTES + weights_bytes - (count_half_bytes(settings) if half else 0) + VALUE_BYTES * values)


@functools.cache
def count_half_bytes(settings: VggtSettings) -> int:
    """What is saved by holding the attention's matrices in half the bytes."""
    with torch.device("meta"):
        return sum(2 * parameter.numel() for part in list_matrices(Vggt(settings)) for parameter in part.parameters())


def check_fits(name: str, predict: Callable[[int], int], frames: int, size_px: tuple[int, int], available_bytes: int, where: str) -> int:
    """The predicted peak in bytes.

    Args:
        name: of the network, for the user.
        predict: the most memory that a run over so many images takes.
        frames: number of images.
        size_px: (width, height) of what the network sees.
        available_bytes: of memory that is free, on the device `where`.

    Raises:
        StepError: it is more than there is; says what would fit.
    """
    needed = predict(frames)
    if needed <= available_bytes:
        return needed
    fits = next((count for count in range(frames - 1, 1, -1) if predict(count) <= available_bytes), 0)
    remedy = f"{fits} images would fit" if fits >= 3 else "not even 3 images would fit"
    raise StepError(
        f"{name} needs about {needed / 1e9:.1f} GB for {frames} images of {size_px[0]} x {size_px[1]} px, {where} has"
        f" {available_bytes / 1e9:.1f} GB free; {remedy}. Take fewer images, or the registration colmap"
    ) from MemoryError()


class Loaded(Protocol):
    """A network that is ready."""

    precision: torch.dtype


Network = TypeVar("Network", bound=Loaded)


def load_network(
    name: str,
    build: Callable[[str, torch.dtype, int], Network],
    predict: Callable[[int, int, bool], int],
    image_set: ImageSet,
    size_px: tuple[int, int],
    args: argparse.Namespace,
) -> tuple[Network, dict[str, Any]]:
    """The network on the device of the command line, once a run is known to fit there, and figures of that for the record.

    Args:
        name: of the network, for the user.
        build: makes it on a device, in a precision, with so many images at a time in its heads.
        predict: the most memory that a run over so many images takes, with so many at a time in the heads, in bfloat16 or not.
        image_set: what to register.
        size_px: (width, height) of what the network sees.
        args: of the command line: `device`, `precision` and `threads`.

    Raises:
        StepError: it does not fit.
    """
    device = choose_device(args.device)
    precision, frames, available = choose_precision(args.precision, device), len(image_set.images), measure_free_bytes(device)
    half = precision == torch.bfloat16
    chunk = next((count for count in CHUNKS[device] if predict(frames, count, half) <= available), CHUNKS[device][-1])
    needed = check_fits(name, lambda count: predict(count, chunk, half), frames, size_px, available, f"the {device}")
    torch.set_num_threads(max(1, min(args.threads, os.cpu_count() or 1)))
    network = build(device, precision, chunk)
    known = {"device": device, "precision": str(network.precision).removeprefix("torch."), "images_at_a_time": chunk}
    return network, known | {"predicted_peak_gb": round(needed / 1e9, 2)}
