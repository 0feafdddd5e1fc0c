"""PatchMatch's CUDA kernels against the CPU's: in Numba's simulator, and on a device where there is one."""

import numpy as np
import pytest

from helpers import simulated_stereo
from helpers.simulator import run_in_simulator
from zeroshop_steps.runtime.compute.kernel_devices import has_cuda
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.mvs.cpu_patchmatch import CpuPatchMatch
from zeroshop_steps.surface.mvs.patchmatch import make_patchmatch


def measure_agreement(found: list[np.ndarray], expected: list[np.ndarray]) -> float:
    """The share of the pixels with a depth whose plane and cost are those expected, up to the rounding of single precision."""
    depth, normal, cost = (np.abs(mine - theirs) for mine, theirs in zip(found, expected, strict=True))
    known = expected[0] > 0
    assert known.sum() > 150 and np.array_equal(found[0] > 0, known)
    return float(((depth < 1e-5) & (normal.max(axis=-1) < 1e-5) & (cost < 1e-4))[known].mean())


@pytest.mark.slow
def test_the_simulated_kernels_find_the_planes_that_the_cpu_finds(tmp_path):
    run_in_simulator(simulated_stereo.__file__, str(tmp_path / "found.npz"))
    found = np.load(tmp_path / "found.npz")
    # All of them do here. Another machine may round a random number's cosine differently, and two planes may cost the same.
    assert measure_agreement([found["depth"], found["normal"], found["cost"]], simulated_stereo.search("cpu")) > 0.98


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
def test_a_device_finds_the_planes_that_the_cpu_finds_and_the_same_bytes_twice():
    cpu, gpu, again = (simulated_stereo.search(device, 3, 2, size_px=144) for device in ("cpu", "cuda", "cuda"))
    assert measure_agreement(gpu, cpu) > 0.9
    assert all(mine.tobytes() == theirs.tobytes() for mine, theirs in zip(gpu, again, strict=True))


def test_an_absent_device_is_refused_and_auto_does_without(monkeypatch):
    monkeypatch.setattr("zeroshop_steps.runtime.compute.kernel_devices.has_cuda", lambda: False)
    nothing = np.zeros((3, 1, 1), np.float32)
    assert isinstance(make_patchmatch("auto", (), nothing, nothing), CpuPatchMatch)
    with pytest.raises(StepError, match="finds no CUDA device"):
        make_patchmatch("cuda", (), nothing, nothing)
