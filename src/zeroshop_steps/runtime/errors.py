"""What a step says to its user: the one error type, and warnings."""

import contextlib
import errno
import os
import resource
import sys
import tempfile
from pathlib import Path


class StepError(Exception):
    """Something the user can act on: names the file or option, what was expected and the remedy.

    A step that raises it ends with status 1 and prints the message without a traceback.
    """

    def write_details(self, folder: Path) -> None:
        """Leave in the folder that holds the record of this failure (failures.py) what helps to see why; most have nothing."""


REMEDY_FOR_ROOM = "Check free disk space (df -h, and df -i for the number of files) and the largest size of a file (ulimit -f)."
_REMEDIES = {
    errno.ENOSPC: REMEDY_FOR_ROOM,
    errno.EDQUOT: "Your quota of disk space is used up; remove files or ask for more.",
    errno.EFBIG: "The file is larger than this shell or file system allows; ulimit -f shows and changes the shell's limit.",
    errno.EACCES: "Check permissions: ls -ld on it and on the folders above it.",
    errno.EPERM: "Check permissions: ls -ld on it and on the folders above it.",
    errno.EROFS: "That file system is read-only; work in another folder.",
    errno.ENAMETOOLONG: "Use shorter names: most file systems end at 255 bytes a name.",
    errno.ELOOP: "A link there leads back to itself; remove it.",
    errno.ENOENT: "Check the path, or run the step that writes it.",
    errno.EISDIR: "A file is needed there, not a folder.",
    errno.ENOTDIR: "A part of that path is a file, not a folder.",
    errno.EMFILE: "Too many files are open; ulimit -n shows and changes the limit.",
    errno.EIO: "The disk or network has a fault; dmesg may say more.",
}


def remedy_for(error: OSError) -> str:
    """What a user can do about an error of the system."""
    return _REMEDIES.get(error.errno or 0, "Check free disk space and permissions.")


_NO_MEMORY = ("allocate memory", "Failed to allocate", "Insufficient memory", "not enough memory", "out of memory", "bad_alloc")
_NO_ROOM = ("No registered database factory succeeded", "database or disk is full", "disk I/O error", "No space left on device")


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory ran out, in the words of Python, PyTorch, OpenCV or NumPy; by name, since few steps load PyTorch."""
    told = type(error).__name__ == "OutOfMemoryError" or any(words in str(error) for words in _NO_MEMORY)
    return isinstance(error, MemoryError) or (isinstance(error, Exception) and not isinstance(error, StepError) and told)


def is_disk_full(error: BaseException) -> bool:
    """Whether the disk took no more, in the words of COLMAP, whose errors have no number, and SQLite."""
    return isinstance(error, RuntimeError | ValueError) and any(words in str(error) for words in _NO_ROOM)


def explain_machine_fault(error: BaseException) -> str | None:
    """What the machine did wrong, in one line with the remedy; None where an error has another cause."""
    if isinstance(error, StepError):
        return None
    if is_out_of_memory(error):
        return f"memory ran out: {describe_memory()}"
    if is_disk_full(error):
        return f"the disk of the results or of {tempfile.gettempdir()} is full or may not be written to. {REMEDY_FOR_ROOM}"
    if isinstance(error, OSError) and error.errno is not None:
        name = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
        return f"{name}{error.strerror}. {remedy_for(error)}"
    return None


LEAST_MEMORY_MB = 2000
"""For any object: what training and grading take at their fixed sizes (20 images of 1000 x 750 px)."""
FIXED_MB, MB_PER_MEGAPIXEL = 600, 30
"""Of the texture, the step that holds all images as they are: 0.67 GB for 3 megapixels in all, 1.36 GB for 28, 2.06 GB for 49."""


def describe_memory() -> str:
    """How much memory a process may take and the machine has left, what that is enough for, and the remedy."""
    there_mb = {}
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        there_mb["ulimit -v allows {:.0f} MB"] = limit / 1e6
    with contextlib.suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/meminfo").read_text().splitlines()
        there_mb["the machine has {:.0f} MB free"] = int(next(line for line in lines if line.startswith("MemAvailable")).split()[1]) / 1e3
    told = ", ".join(words.format(mb) for words, mb in there_mb.items())
    fit = _describe_fit(min(there_mb.values(), default=0.0))
    return f"{told}. {fit} Give it more memory, run less beside it, or take fewer or smaller images"


def _describe_fit(memory_mb: float) -> str:
    """Which images fit into so much memory."""
    if memory_mb < LEAST_MEMORY_MB:
        return f"Any object needs {LEAST_MEMORY_MB} MB, and large images more."
    megapixels = (memory_mb - FIXED_MB) / MB_PER_MEGAPIXEL
    return f"That is enough for {megapixels:.0f} megapixels in all images together, such as 20 images of {megapixels / 20:.1f} megapixels."


WARNING = "warning: "
"""How a line of a step's log begins that the workflow repeats at its end."""


def warn(message: str) -> None:
    """Warn of something in a result that is valid nevertheless."""
    print(f"{WARNING}{message}", file=sys.stderr)
