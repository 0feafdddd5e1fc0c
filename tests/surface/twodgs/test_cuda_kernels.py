"""The CUDA kernels: in Numba's simulator against the float64 twin, and on a device, where there is one, against the CPU's."""

import numpy as np
import pytest
import torch

from helpers import few_primitives
from helpers.simulated_cuda import SURFEL_TENSORS, simulate
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.compute.kernel_devices import has_cuda
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.rendering.tiling import tiles_of
from zeroshop_steps.surface.twodgs.kernels import layout, project, tiles
from zeroshop_steps.surface.twodgs.render import RenderView, render
from zeroshop_steps.surface.twodgs.renderers import CpuRenderer, CudaRenderer, list_slots_by_tile, make_renderer

WIDTH_PX, HEIGHT_PX, SPLATS = 20, 10, 24


def make_view() -> RenderView:
    camera_from_world = np.eye(4)
    camera_from_world[:3, 3] = [0.1, -0.05, 3.0]
    camera = Camera("view", WIDTH_PX, HEIGHT_PX, np.array([[30.0, 0, 10.7], [0, 29.0, 5.6], [0, 0, 1]]), camera_from_world)
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
    few_primitives.check(found, few_primitives.trained(few_primitives.make_surfel_trainer("cpu")))


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
def test_training_on_a_device_goes_as_on_the_cpu_and_gives_the_same_bytes_twice():
    cpu, found, again = (few_primitives.trained(few_primitives.make_surfel_trainer(device)) for device in ("cpu", "cuda", "cuda"))
    few_primitives.check(found, cpu)
    assert all(value.tobytes() == again[name].tobytes() for name, value in found.items())


@pytest.mark.skipif(not has_cuda(), reason="Numba finds no CUDA device")
@pytest.mark.parametrize("seed", range(3))
def test_the_kernels_match_the_cpu_on_a_device_and_give_the_same_bytes_twice(seed):
    results = []
    for renderer in (CpuRenderer(), CudaRenderer(), CudaRenderer()):
        tensors = [torch.tensor(array, requires_grad=True, device=renderer.device) for array in make_scene(seed)]
        r = render(*tensors, 3, make_view(), distortion=True, renderer=renderer)
        (r.color.sum() + r.depth.sum() + r.normal.sum() + r.distortion.sum()).backward()
        parts = [r.color, r.depth, r.statistics.centre_gradient, *(tensor.grad for tensor in tensors)]
        results.append([part.detach().cpu().numpy() for part in parts])
    for cpu, gpu, again in zip(*results, strict=True):
        assert measure_error(gpu, cpu) < 1e-4 and gpu.tobytes() == again.tobytes()


def test_a_device_that_is_absent_or_unknown_is_refused(monkeypatch):
    monkeypatch.setattr("zeroshop_steps.runtime.compute.kernel_devices.has_cuda", lambda: False)
    assert isinstance(make_renderer("auto"), CpuRenderer) and isinstance(make_renderer("cpu"), CpuRenderer)
    with pytest.raises(StepError, match="finds no CUDA device"):
        make_renderer("cuda")
    with pytest.raises(StepError, match="expected cpu, cuda or auto"):
        make_renderer("gpu")


def test_a_device_that_only_the_kernels_find_is_refused(monkeypatch):
    monkeypatch.setattr("zeroshop_steps.runtime.compute.kernel_devices.has_cuda", lambda: True)
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert isinstance(make_renderer("auto"), CpuRenderer)
    with pytest.raises(StepError, match="PyTorch does not"):
        make_renderer("cuda")


@pytest.mark.parametrize("seed", range(3))
def test_lists_by_sorting_are_those_of_the_cpu(seed):
    """Half of the surfels lie at equal depths, where their number decides."""
    view, arrays = make_view(), make_scene(seed)
    arrays[0][::2, 2] = 0.5
    splats, boxes = np.zeros((SPLATS, layout.SPLAT_WIDTH), np.float32), np.empty((SPLATS, 4), np.int32)
    outlines = np.empty((SPLATS, layout.OUTLINE_WIDTH), np.float32)
    project.project_forward(*arrays, 3, view.camera, WIDTH_PX, 40, view.near, 1, splats, outlines, boxes)
    tile_active = np.array([[True, True], [False, True], [True, True]])
    expected = tiles.list_splats_by_tile(splats, outlines, boxes, tile_active, 1)
    firsts, counts = expected.slot_starts[:-1], np.diff(expected.slot_starts)
    splat_of = np.repeat(np.arange(SPLATS), counts)
    place, (left, right, top, _) = np.arange(len(splat_of)) - firsts[splat_of], np.array([tiles_of(box[None], 0) for box in boxes]).T
    across = (right - left)[splat_of]
    tile_of = (top[splat_of] + place // across) * 2 + left[splat_of] + place % across
    given = (torch.from_numpy(array.astype(np.int32)) for array in (expected.blocks, tile_of, splat_of))
    found = list_slots_by_tile(torch.from_numpy(splats[:, layout.ZC]), *given, tile_active.size)
    assert len(expected.splat_of) > SPLATS
    for mine, theirs in zip(found, (expected.starts, expected.splat_of, expected.slot_of), strict=True):
        assert np.array_equal(mine.numpy(), theirs)
