"""Programs whose CUDA kernels run in Numba's simulator."""

import os
import subprocess
import sys

from helpers.paths import REPOSITORY

SIMULATED = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore::RuntimeWarning"}
"""The simulator has to be chosen before Numba is imported. Functions that kernels share with the CPU must take its arrays: no compiling.
Random numbers overflow on purpose, of which NumPy warns."""


def run_in_simulator(program: str, *words: str) -> None:
    """Run a Python file of the tests in a process of its own."""
    paths = os.pathsep.join(
        [*(str(REPOSITORY / folder) for folder in ("tests", "benchmarks")), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    subprocess.run([sys.executable, program, *words], env={**os.environ, **SIMULATED, "PYTHONPATH": paths}, check=True, timeout=500)
