"""The work of every view in threads."""

import threading
import time

import numba
import pytest

from zeroshop_steps.runtime.compute.thread_pool import map_in_threads


def test_results_keep_the_order_of_the_arguments() -> None:
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    assert map_in_threads(lambda a, b: (time.sleep(0.01 * (3 - a)), a + b)[1], [1, 2, 3], [10, 20, 30]) == [11, 22, 33]
    assert map_in_threads(len, []) == []


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="Numba has one thread here")
def test_as_many_threads_work_as_kernels_have() -> None:
    numba.set_num_threads(2)
    together = threading.Barrier(2, timeout=10)
    assert map_in_threads(lambda _: together.wait() >= 0, [1, 2]) == [True, True]


def test_one_thread_is_the_callers() -> None:
    numba.set_num_threads(1)
    assert map_in_threads(lambda _: threading.current_thread(), [1, 2]) == [threading.current_thread()] * 2


def test_sequences_of_different_lengths_and_errors_are_raised() -> None:
    with pytest.raises(ValueError, match="shorter"):
        map_in_threads(lambda a, b: a, [1, 2], [1])
    with pytest.raises(ZeroDivisionError):
        map_in_threads(lambda a: 1 / a, [1, 0, 2])
