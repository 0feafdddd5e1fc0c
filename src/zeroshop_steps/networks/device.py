"""Where a network runs, in which precision, and whether it fits there."""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass

import torch

from zeroshop_steps.errors import StepError

DEVICES = ("auto", "cpu", "cuda")
RESERVE = 0.9
"""Share of the free memory that a network may take."""


def chosen_device(name: str) -> torch.device:
    """The device of a name; "auto" is CUDA where there is one.

    Raises:
        StepError: CUDA is asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise StepError("device cuda is asked for, but PyTorch sees no CUDA device here; use --device cpu or auto")
    return torch.device(name if name != "auto" else "cuda" if torch.cuda.is_available() else "cpu")


def free_bytes(device: torch.device) -> int:
    """Memory that can still be taken on a device."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    try:
        with open("/proc/meminfo") as file:
            lines = dict(line.split(":", 1) for line in file)
        return int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Needs:
    """Memory that a run will take at its peak.

    Attributes:
        peak_bytes: all of it.
        what: what of, in words: "MASt3R on 20 images of 512 x 384 px".
        instead: what would fit, or what else to do, in words.
    """

    peak_bytes: int
    what: str
    instead: str


def fits(peak_bytes: int, device: torch.device) -> bool:
    """Whether so much memory can be taken on a device."""
    return peak_bytes <= RESERVE * free_bytes(device)


def check_fits(needs: Needs, device: torch.device) -> None:
    """Raise StepError with the numbers where a run cannot fit on a device."""
    if not fits(needs.peak_bytes, device):
        free = free_bytes(device)
        raise StepError(
            f"{needs.what} takes {needs.peak_bytes / 1e9:.1f} GB at its peak, the device {device.type} has {free / 1e9:.1f} GB free:"
            f" {needs.instead}"
        )


@contextlib.contextmanager
def running(device: torch.device, what: str) -> Iterator[None]:
    """Run a network without gradients, in bfloat16 where a CUDA device has it.

    Raises:
        StepError: out of memory all the same.
    """
    half = device.type == "cuda" and torch.cuda.is_bf16_supported()
    try:
        with torch.inference_mode(), torch.autocast(device.type, dtype=torch.bfloat16, enabled=half):
            yield
    except RuntimeError as error:
        if not isinstance(error, torch.OutOfMemoryError) and "allocate memory" not in str(error):
            raise
        remedy = "use --device cpu" if device.type == "cuda" else "run less beside it"
        raise StepError(f"{what} ran out of memory on {device.type}: {str(error).splitlines()[0]}; {remedy}") from None
