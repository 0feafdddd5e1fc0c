"""Which device a network runs on, in which precision, and how much memory is free there."""

import os
from pathlib import Path

import torch

from zeroshop_steps.errors import StepError

CGROUP = Path("/sys/fs/cgroup")


def chosen_device(name: str) -> str:
    """ "cpu" or "cuda" for one of auto, cpu and cuda. Raises StepError where cuda is asked for and absent."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        built = "" if torch.backends.cuda.is_built() else "; this build of PyTorch is for the processor alone, install one with CUDA"
        raise StepError(f"--device cuda: PyTorch finds no CUDA device{built}. Use --device cpu, or auto")
    return name


def chosen_precision(name: str, device: str) -> torch.dtype:
    """The number format for one of auto, float32 and bfloat16: auto is bfloat16 where a CUDA device calculates in it."""
    if name == "auto":
        return torch.bfloat16 if device == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False) else torch.float32
    return {"float32": torch.float32, "bfloat16": torch.bfloat16}[name]


def free_bytes(device: str) -> int:
    """Memory that a new process can have: of the CUDA device, or of this machine within the limits of its control group."""
    if device == "cuda":
        return torch.cuda.mem_get_info()[0]
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _text(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            free = 1024 * int(line.split()[1])
    limit, used = _text(CGROUP / "memory.max").strip(), _text(CGROUP / "memory.current").strip()
    return min(free, int(limit) - int(used)) if limit.isdigit() and used.isdigit() else free


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
