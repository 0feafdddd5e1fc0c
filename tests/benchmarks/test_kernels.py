"""That `make bench` runs and prints its tables; what it measures is never tested."""

import subprocess
import sys

import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.runtime.compute.device_arrays import choose_kernels

SCRIPT = REPOSITORY / "benchmarks" / "kernels.py"


@pytest.mark.slow
def test_the_benchmark_runs() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--quick"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [line.split()[:2] for line in done.stdout.splitlines()]
    assert ["2dgs", "small"] in rows and ["svraster", "small"] in rows
    assert "FP32 peak" in done.stdout and "growth" in done.stdout and done.stdout.count("times faster than the twin") == 2
    assert "other processes used" in done.stdout
    assert ("no CUDA device: Numba and PyTorch" in done.stdout) == (choose_kernels("auto") == "cpu")
