"""How many threads this stage's kernels use."""

import os

import numba
import torch


def use_threads(threads: int) -> int:
    """Set the kernels' threads, at most the machine's; returns how many."""
    threads = max(1, min(threads, os.cpu_count() or 1))
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    # The losses' small images gain nothing from a second thread, and a fixed number keeps sums in one order.
    torch.set_num_threads(1)
    return threads
