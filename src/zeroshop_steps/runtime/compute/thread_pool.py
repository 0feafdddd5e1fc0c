"""The same work for every view, in as many threads as the job has."""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2
import numba

Result = TypeVar("Result")


def map_in_threads(function: Callable[..., Result], *sequences: Iterable, most_threads: int | None = None) -> list[Result]:
    """What `function` returns for the first of each sequence, for the second and so on. All have one length.

    It pays where most of the time goes to OpenCV, NumPy's large arrays, and kernels with `nogil`, which leave the interpreter to other
    threads. `function` must not start kernels that use several threads: Numba's must be started by one at a time. `most_threads` is for
    work that takes much memory.
    """
    arguments = list(zip(*sequences, strict=True))
    threads = min(numba.get_num_threads(), len(arguments), most_threads or len(arguments))
    if threads < 2 or threading.current_thread() is not threading.main_thread():
        return [function(*one) for one in arguments]
    opencv_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # its own threads would wait beside these, and keep cores busy with it
    try:
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(lambda one: function(*one), arguments))
    finally:
        cv2.setNumThreads(opencv_threads)
