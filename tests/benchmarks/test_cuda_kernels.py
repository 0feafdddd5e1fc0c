"""That all CUDA kernels can be compiled for a card, where the extra `gpu` is installed: no device is needed for that."""

import importlib.util
import subprocess
import sys

import pytest

from helpers.paths import REPOSITORY

SCRIPT = REPOSITORY / "benchmarks" / "cuda_kernels.py"
HAS_EXTRA = importlib.util.find_spec("numba_cuda") is not None
KERNELS = 20


def compile_all(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *words], capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.skipif(not HAS_EXTRA, reason="the extra `gpu` is not installed")
def test_all_kernels_compile_and_none_spills_registers() -> None:
    done = compile_all("--capability", "8.9")
    assert done.returncode == 0, done.stderr
    header, *rows = (line.split() for line in done.stdout.splitlines())
    local, spilled, shared = (header.index(name) - 2 for name in ("local", "spilled", "shared"))
    assert len(rows) == KERNELS
    for row in (" ".join(row).replace(" B", "B").split() for row in rows):
        assert row[spilled] == "none", row
        if "blend" in row[0]:
            assert row[local] == "none" and row[shared] != "none", row


@pytest.mark.skipif(HAS_EXTRA, reason="the extra `gpu` is installed")
def test_without_the_extra_it_says_what_to_install() -> None:
    done = compile_all()
    assert done.returncode == 1 and "install the extra `gpu`" in done.stderr and "Traceback" not in done.stderr
