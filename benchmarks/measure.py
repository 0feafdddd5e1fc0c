"""CPU time, wall time, memory and the FP32 peak of this machine, and whether something else kept it busy."""

import ctypes
import gc
import os
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import torch


class Clock:
    """CPU time of actions on one thread, and how much of their wall time they waited for a core."""

    def __init__(self) -> None:
        self.cpu, self.wall = 0.0, 0.0

    def cpu_seconds(self, action: Callable[[], None], repeats: int = 1) -> float:
        """Least CPU time that an action takes."""
        least = np.inf
        for _ in range(repeats):
            cpu, wall = time.process_time(), time.perf_counter()
            action()
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            self.cpu, self.wall, least = self.cpu + cpu, self.wall + wall, min(least, cpu)
        return least

    def waiting_share(self) -> float:
        """Share of the wall time of all actions in which they did not run."""
        return max(0.0, 1.0 - self.cpu / self.wall)


def synchronised_seconds(action: Callable[[], object]) -> float:
    """Wall time until the CUDA device has done all that an action asks of it, and nothing else: calls only put work into its queue."""
    torch.cuda.synchronize()
    start = time.perf_counter()
    action()
    torch.cuda.synchronize()
    return time.perf_counter() - start


def wall_seconds(action: Callable[[], None]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def one_against_two_threads(action: Callable[[], None], repeats: int) -> tuple[float, float]:
    """Best wall time with one thread and with two, taken in turn, so that both see the same machine."""
    best = {1: np.inf, 2: np.inf}
    for _ in range(repeats):
        for threads in best:
            numba.set_num_threads(threads)
            best[threads] = min(best[threads], wall_seconds(action))
    numba.set_num_threads(1)
    return best[1], best[2]


@numba.njit(fastmath={"contract"}, error_model="numpy")
def _fused_multiply_adds(x, rounds):
    a, b = np.float32(0.999), np.float32(0.001)
    for _ in range(rounds):
        for i in range(len(x)):
            v = x[i]
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            v = v * a + b
            x[i] = v


def peak_flops_per_second(clock: Clock, repeats: int = 5) -> float:
    """Single-precision operations a second of one core, in a loop of fused multiply-adds that stays in the first cache."""
    x, rounds = np.zeros(2048, np.float32), 3000
    _fused_multiply_adds(x, 1)
    return 2 * 16 * len(x) * rounds / clock.cpu_seconds(lambda: _fused_multiply_adds(x, rounds), repeats)


def peak_memory_mb(action: Callable[[], None]) -> float | None:
    """By how much the resident memory rises while an action runs; None where the system does not tell."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        before = _status_mb("VmRSS")
        action()
        return _status_mb("VmHWM") - before
    except (OSError, AttributeError, StopIteration):
        return None


def _status_mb(field: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(field)).split()[1]) / 1024


class Company:
    """How many cores other processes use, from the system's own counters."""

    def __init__(self) -> None:
        self.start = self._now()

    @staticmethod
    def _now() -> tuple[float, float, float]:
        times = os.times()
        try:
            user, nice, system = (int(x) for x in Path("/proc/stat").read_text().split("\n")[0].split()[1:4])
            everyone = (user + nice + system) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError):
            everyone = np.nan
        return time.perf_counter(), times.user + times.system, everyone

    def others_cores(self) -> float:
        """Mean number of cores that other processes used since the start; nan where the system does not tell."""
        wall, own, everyone = (now - then for now, then in zip(self._now(), self.start, strict=True))
        return (everyone - own) / wall
