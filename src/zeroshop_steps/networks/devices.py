"""Which device a network runs on, in which precision, and how much memory is free there."""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch

from zeroshop_steps.runtime.compute.kernel_devices import DEVICES as DEVICES
from zeroshop_steps.runtime.errors import StepError, is_out_of_memory

CGROUP = Path("/sys/fs/cgroup")
PROCESS_BYTES = 700_000_000
"""Of a process beside its networks: Python, PyTorch and the libraries; 0.3 to 0.7 GB were measured."""
RESERVE = 0.9
"""Share of the free memory that a network may take."""


def choose_device(name: str) -> str:
    """ "cpu" or "cuda" for one of auto, cpu and cuda. Raises StepError where cuda is asked for and absent."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        built = "" if torch.backends.cuda.is_built() else "; this build of PyTorch is for the processor alone, install one with CUDA"
        raise StepError(f"--device cuda: PyTorch finds no CUDA device{built}. Use --device cpu, or auto")
    return name


def choose_precision(name: str, device: str) -> torch.dtype:
    """The number format for one of auto, float32 and bfloat16: auto is bfloat16 where a CUDA device calculates in it."""
    if name == "auto":
        return torch.bfloat16 if device == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False) else torch.float32
    return {"float32": torch.float32, "bfloat16": torch.bfloat16}[name]


def measure_free_bytes(device: str) -> int:
    """Memory that a new process can have: of the CUDA device, or of this machine within the limits of its control group."""
    if device == "cuda":
        return torch.cuda.mem_get_info()[0]
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _read_text(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            free = 1024 * int(line.split()[1])
    limit, used = _read_text(CGROUP / "memory.max").strip(), _read_text(CGROUP / "memory.current").strip()
    return min(free, int(limit) - int(used)) if limit.isdigit() and used.isdigit() else free


@dataclass(frozen=True)
class MemoryNeeds:
    """Memory that a run will take at its peak.

    Attributes:
        peak_bytes: all of it.
        what: what of, in words: "MASt3R on 20 images of 512 x 384 px".
        instead: what would fit, or what else to do, in words.
    """

    peak_bytes: int
    what: str
    instead: str


def fits_in_memory(peak_bytes: int, device: torch.device) -> bool:
    """Whether so much memory can be taken on a device."""
    return peak_bytes <= RESERVE * measure_free_bytes(device.type)


def check_memory(needs: MemoryNeeds, device: torch.device) -> None:
    """Raise StepError with the numbers where a run cannot fit on a device."""
    if not fits_in_memory(needs.peak_bytes, device):
        free = measure_free_bytes(device.type)
        raise StepError(
            f"{needs.what} takes {needs.peak_bytes / 1e9:.1f} GB at its peak, the device {device.type} has {free / 1e9:.1f} GB free:"
            f" {needs.instead}"
        ) from MemoryError()


@contextlib.contextmanager
def run_network(device: torch.device, what: str, precision: str = "auto") -> Iterator[None]:
    """Run a network without gradients, by default in bfloat16 where a CUDA device has it.

    Heads, coordinates and solvers need single precision; within this, they switch autocasting off.

    Raises:
        StepError: out of memory all the same.
    """
    number_format = choose_precision(precision, device.type)
    try:
        with torch.inference_mode(), torch.autocast(device.type, dtype=number_format, enabled=number_format != torch.float32):
            yield
    except RuntimeError as error:
        if not is_out_of_memory(error):
            raise
        remedy = "use --device cpu" if device.type == "cuda" else "run less beside it"
        raise StepError(f"{what} ran out of memory on {device.type}: {str(error).splitlines()[0]}; {remedy}") from MemoryError()


def _read_text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
