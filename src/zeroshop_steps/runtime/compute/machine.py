"""Is there room for what a library will need? Some end the whole process, without a word, where disk or memory runs out."""

import os
import resource
import shutil
from pathlib import Path

from zeroshop_steps.runtime.errors import StepError


def require_room(folder: Path, needed_bytes: int, what: str) -> None:
    """Raise StepError where the disk of a folder has less free than is needed; `what` needs it, for the message."""
    free_bytes = shutil.disk_usage(folder).free
    if free_bytes < needed_bytes:
        raise StepError(
            f"{what} need {needed_bytes / 1e6:.0f} MB of disk, more than the {free_bytes / 1e6:.1f} MB that are free at {folder}."
            " Check free disk space (df -h) and make room"
        ) from OSError("no room")


def require_memory(needed_bytes: int, what: str) -> None:
    """Raise StepError where the limit on this process's memory (ulimit -v) leaves less than is needed; `what` needs it."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return
    used_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    if limit - used_bytes < needed_bytes:
        raise StepError(
            f"{what} need {needed_bytes / 1e6:.0f} MB of memory, and the limit of this shell (ulimit -v) leaves"
            f" {max(0, limit - used_bytes) / 1e6:.0f} MB: raise it to {(used_bytes + needed_bytes) / 1e3:.0f} kB or more, or lift it"
        ) from MemoryError("ulimit -v")
