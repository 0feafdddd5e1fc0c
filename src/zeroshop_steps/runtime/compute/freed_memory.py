"""Keep freed memory for the next array, instead of giving it back to the system, which has to clear it when it is asked for anew.

Steps make arrays of some megabytes one after the other. By default, glibc asks the system for each of them.
"""

import ctypes
import sys

# Parameters of mallopt(3): how much free memory at the top is given back, how much is asked for at once, what is mapped on its own.
TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3
KEPT_BYTES, ASKED_BYTES, MAPPED_BYTES = 2**31 - 1, 2**26, 2**30


def keep_freed_memory() -> None:
    """Tell glibc's allocator so, for this process; nothing where there is another."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        for parameter, value in ((MMAP_THRESHOLD, MAPPED_BYTES), (TRIM_THRESHOLD, KEPT_BYTES), (TOP_PAD, ASKED_BYTES)):
            mallopt(parameter, value)
