"""The CUDA kernels: in Numba's simulator against the float64 twin, and on a device, where there is one, against the CPU's."""

import numpy as np
import pytest
import torch

from helpers import few_primitives
from helpers.simulated_cuda import VOXEL_TENSORS, simulate
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.compute.kernel_devices import has_cuda
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.svraster.octree import Octree
from zeroshop_steps.surface.svraster.render import RenderView, render
from zeroshop_steps.surface.svraster.renderers import CpuRenderer, CudaRenderer, make_renderer

WIDTH_PX, HEIGHT_PX = 20, 14


def make_camera() -> Camera:
    """It looks along a plane between voxels, so that its rays have two octants of directions."""
    camera_from_world, (c, s) = np.eye(4), (np.cos(0.5), np.sin(0.5))
    tilted = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    camera_from_world[:3, :3], camera_from_world[:3, 3] = tilted @ np.eye(3)[[1, 2, 0]], [0.1, -0.05, 3.0]
    return Camera("view", WIDTH_PX, HEIGHT_PX, np.array([[26.0, 0, 10.6], [0, 25.0, 7.4], [0, 0, 1]]), camera_from_world)


def make_scene(seed: int) -> tuple[Octree, np.ndarray, np.ndarray]:
    """Leaves of two levels, one behind the other, values at their corners, and spherical harmonics."""
    rng = np.random.default_rng(seed)
    octree = Octree.uniform(np.ones((2, 2, 2), bool))
    octree, _ = octree.refine(np.arange(8) != 5, np.arange(8) == 2)
    values = rng.normal(-2.0, 1.5, octree.corner_count)
    return octree, values.astype(np.float32), (rng.normal(size=(len(octree), 16, 3)) * 0.4).astype(np.float32)


def measure_error(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found.astype(np.float64) - expected) / max(np.linalg.norm(expected), 1e-9))


@pytest.mark.slow
def test_the_simulated_kernels_match_the_float64_twin(tmp_path):
    camera, (octree, *arrays) = make_camera(), make_scene(0)
    assert len(set(RenderView.from_camera(camera).tile_octants.octants)) > 1
    given = dict(zip(VOXEL_TENSORS, arrays, strict=True)) | {"origins": octree.origins, "levels": octree.levels}
    view = {"size_px": (WIDTH_PX, HEIGHT_PX), "intrinsics": camera.intrinsics, "camera_from_world": camera.camera_from_world}
    found = simulate("voxels", tmp_path, **given, **view)
    decided = found["decided"]
    assert decided.mean() > 0.9 and found["expected"][7].max() > 0.9 and found["expected"][8].max() > 0.0, "the scene must show something"
    for plane, (mine, expected) in enumerate(zip(found["image"], found["expected"], strict=True)):
        assert measure_error(mine[decided], expected[decided]) < 1e-4, f"plane {plane}"
    for name in VOXEL_TENSORS:
        assert measure_error(found[f"gradient_{name}"], found[f"expected_{name}"]) < 1e-4, f"gradient of {name}"
    for name in ("weight", "priority"):
        assert measure_error(found[name], found[f"expected_{name}"]) < 1e-4, name
    few_primitives.check(found, few_primitives.trained(few_primitives.make_voxel_trainer("cpu")))


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
def test_training_on_a_device_goes_as_on_the_cpu_and_gives_the_same_bytes_twice():
    cpu, found, again = (few_primitives.trained(few_primitives.make_voxel_trainer(device)) for device in ("cpu", "cuda", "cuda"))
    few_primitives.check(found, cpu)
    assert all(value.tobytes() == again[name].tobytes() for name, value in found.items())


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
@pytest.mark.parametrize("seed", range(3))
def test_the_kernels_match_the_cpu_on_a_device_and_give_the_same_bytes_twice(seed):
    results = []
    for renderer in (CpuRenderer(), CudaRenderer(), CudaRenderer()):
        octree, *arrays = make_scene(seed)
        tensors = [torch.tensor(array, requires_grad=True, device=renderer.device) for array in arrays]
        r = render(octree, *tensors, 3, RenderView.from_camera(make_camera()), renderer)
        (r.color.sum() + r.depth.sum() + r.normal.sum() + r.away.sum() + r.median_depth.sum()).backward()
        parts = [r.color, r.depth, r.statistics.priority, *(tensor.grad for tensor in tensors)]
        results.append([part.detach().cpu().numpy() for part in parts])
    for cpu, gpu, again in zip(*results, strict=True):
        assert measure_error(gpu, cpu) < 1e-4 and gpu.tobytes() == again.tobytes()


def test_a_device_that_is_absent_is_refused(monkeypatch):
    monkeypatch.setattr("zeroshop_steps.runtime.compute.kernel_devices.has_cuda", lambda: False)
    assert isinstance(make_renderer("auto"), CpuRenderer) and isinstance(make_renderer("cpu"), CpuRenderer)
    with pytest.raises(StepError, match="finds no CUDA device"):
        make_renderer("cuda")
