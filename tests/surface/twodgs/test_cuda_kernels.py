"""The CUDA kernels: in Numba's simulator against the float64 twin, and on a device, where there is one, against the CPU's."""

import numpy as np
import pytest
import torch

from helpers.simulated_cuda import SURFEL_TENSORS, simulate
from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.kernel_devices import has_cuda
from zeroshop_steps.surface.twodgs.blending import CpuBlending, CudaBlending, make_blending
from zeroshop_steps.surface.twodgs.render import RenderView, render

WIDTH_PX, HEIGHT_PX, SPLATS = 30, 20, 24


def make_view() -> RenderView:
    camera_from_world = np.eye(4)
    camera_from_world[:3, 3] = [0.1, -0.05, 3.0]
    camera = Camera("view", WIDTH_PX, HEIGHT_PX, np.array([[45.0, 0, 16.0], [0, 44.0, 9.0], [0, 0, 1]]), camera_from_world)
    return RenderView.from_camera(camera, 1.5, 6.0)


def make_scene(seed: int) -> list[np.ndarray]:
    """Surfels before the camera: small and large, faint and opaque, one behind it."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform([-0.9, -0.7, -0.8], [0.9, 0.7, 1.0], (SPLATS, 3))
    positions[0, 2] = -9.0
    log_scales = rng.uniform(np.log(0.02), np.log(0.6), (SPLATS, 2))
    arrays = (positions, log_scales, rng.normal(size=(SPLATS, 4)), rng.normal(1.0, 2.0, SPLATS), 0.4 * rng.normal(size=(SPLATS, 16, 3)))
    return [array.astype(np.float32) for array in arrays]


def measure_error(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found.astype(np.float64) - expected) / max(np.linalg.norm(expected), 1e-9))


@pytest.mark.slow
def test_the_simulated_kernels_match_the_float64_twin(tmp_path):
    view = make_view()
    given = dict(zip(SURFEL_TENSORS, make_scene(0), strict=True))
    scalars = {"size_px": (WIDTH_PX, HEIGHT_PX), "near": view.near, "depth_map": view.depth_map}
    found = simulate("surfels", tmp_path, camera=view.camera, tile_active=view.tile_active, **given, **scalars)
    decided = found["decided"]
    assert decided.mean() > 0.9 and found["expected"][7].max() > 0.9, "most pixels must be compared, and the scene must show something"
    for plane, (mine, expected) in enumerate(zip(found["image"], found["expected"], strict=True)):
        assert measure_error(mine[decided], expected[decided]) < 1e-4, f"plane {plane}"
    for name in SURFEL_TENSORS:
        assert measure_error(found[f"gradient_{name}"], found[f"expected_{name}"]) < 1e-4, f"gradient of {name}"


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
@pytest.mark.parametrize("seed", range(3))
def test_the_kernels_match_the_cpu_on_a_device_and_give_the_same_bytes_twice(seed):
    results = []
    for blending in (CpuBlending(), CudaBlending(), CudaBlending()):
        tensors = [torch.tensor(array, requires_grad=True) for array in make_scene(seed)]
        r = render(*tensors, 3, make_view(), distortion=True, blending=blending)
        (r.color.sum() + r.depth.sum() + r.normal.sum() + r.distortion.sum()).backward()
        results.append([r.color.detach().numpy(), r.depth.detach().numpy(), *(tensor.grad.numpy() for tensor in tensors)])
    for cpu, gpu, again in zip(*results, strict=True):
        assert measure_error(gpu, cpu) < 1e-4 and gpu.tobytes() == again.tobytes()


def test_a_device_that_is_absent_or_unknown_is_refused(monkeypatch):
    monkeypatch.setattr("zeroshop_steps.runtime.kernel_devices.has_cuda", lambda: False)
    assert isinstance(make_blending("auto"), CpuBlending) and isinstance(make_blending("cpu"), CpuBlending)
    with pytest.raises(StepError, match="finds no CUDA device"):
        make_blending("cuda")
    with pytest.raises(StepError, match="expected cpu, cuda or auto"):
        make_blending("gpu")
