"""The CPU kernels against the float64 autograd twin: values and gradients, over random and degenerate scenes."""

import numpy as np
import pytest
import torch

from surfel_reference import render_reference
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.twodgs.render import RenderView, render, render_surface_depth

WIDTH_PX, HEIGHT_PX = 40, 35
NEAR, FAR = 1.5, 6.0


def camera() -> Camera:
    rng = np.random.default_rng(5)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = rotation, [0.1, -0.05, 3.0]
    return Camera("view", WIDTH_PX, HEIGHT_PX, np.array([[60.0, 0, 21.0], [0, 58.0, 16.0], [0, 0, 1]]), camera_from_world)


def scene(kind: str, seed: int) -> list[np.ndarray]:
    """Positions, log scales, quaternions, opacity logits and spherical harmonics of a random scene."""
    rng = np.random.default_rng(seed)
    count = 60
    view = camera()
    in_camera = np.stack([rng.uniform(-0.9, 0.9, count), rng.uniform(-0.8, 0.8, count), rng.uniform(2.2, 4.0, count)], 1)
    log_scales = rng.uniform(np.log(0.03), np.log(0.4), (count, 2))
    quaternions = rng.normal(size=(count, 4))
    opacity_logits = rng.normal(0.0, 1.5, count)
    if kind == "tiny":
        log_scales -= 5.0
    if kind == "huge":
        log_scales[::3] += 4.0
    if kind == "behind":
        in_camera[::2, 2] *= -1.0
    if kind == "transparent":
        opacity_logits[::2] = -12.0
    if kind == "opaque":
        opacity_logits += 6.0
    if kind == "grazing":
        # The disk's normal at right angles to the ray to its centre, up to 5 thousandths of a radian;
        # nearer still, a pixel position in single precision is too coarse.
        for i in range(count):
            ray = view.camera_from_world[:3, :3].T @ in_camera[i] / np.linalg.norm(in_camera[i])
            side = np.cross(ray, rng.normal(size=3))
            normal = side / np.linalg.norm(side) + ray * rng.choice([5e-3, 1e-2, 0.05]) * rng.choice([-1, 1])
            normal /= np.linalg.norm(normal)
            w = np.concatenate([[1 + normal[2]], np.cross([0, 0, 1], normal)])
            quaternions[i] = w
    rotation, translation = view.camera_from_world[:3, :3], view.camera_from_world[:3, 3]
    positions = (in_camera - translation) @ rotation
    sh = rng.normal(size=(count, 16, 3)) * 0.4
    return [array.astype(np.float32) for array in (positions, log_scales, quaternions, opacity_logits, sh)]


def both(arrays: list[np.ndarray], degree: int) -> tuple[tuple, tuple]:
    view = RenderView.from_camera(camera(), NEAR, FAR)
    ours = [torch.tensor(array, requires_grad=True) for array in arrays]
    r = render(*ours, degree, view, distortion=True)
    mine = torch.cat([r.color, r.depth[None], r.normal, r.alpha[None], r.median_depth[None], r.distortion[None]])
    twins = [torch.tensor(array.astype(np.float64), requires_grad=True) for array in arrays]
    theirs, undecided = render_reference(*twins, degree, torch.tensor(view.camera), WIDTH_PX, HEIGHT_PX, view.near, view.depth_map)
    weights = torch.tensor(np.random.default_rng(1).normal(size=theirs.shape))
    weights[9] *= 10.0
    assert undecided.double().mean() < 0.1, "most pixels must be compared"
    weights[:, undecided] = 0.0
    theirs, mine = theirs * ~undecided, mine * ~undecided
    (theirs * weights).sum().backward()
    (mine * weights.float()).sum().backward()
    return (mine, ours), (theirs, twins)


@pytest.mark.parametrize("kind", ["usual", "tiny", "huge", "behind", "transparent", "opaque", "grazing"])
@pytest.mark.parametrize("seed", [0, 1])
def test_values_and_gradients_match_the_float64_twin(kind: str, seed: int) -> None:
    (mine, ours), (theirs, twins) = both(scene(kind, seed), degree=3)
    assert theirs[7].max() > 0.1, "the scene must show something"
    for plane in range(10):
        error = (mine[plane].double() - theirs[plane]).norm() / theirs[plane].norm().clamp(min=1e-3)
        assert error < 1e-4, f"plane {plane}: relative error {error:.2e}"
    for name, tensor, twin in zip(("positions", "log_scales", "quaternions", "opacity", "sh"), ours, twins, strict=True):
        error = (tensor.grad.double() - twin.grad).norm() / twin.grad.norm().clamp(min=1e-9)
        assert error < 1e-4, f"gradient of {name}: relative error {error:.2e}"


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_lower_degrees_leave_higher_coefficients_alone(degree: int) -> None:
    (_, ours), (_, twins) = both(scene("usual", 3), degree)
    assert torch.all(ours[4].grad[:, (degree + 1) ** 2 :] == 0)
    assert (ours[0].grad.double() - twins[0].grad).norm() / twins[0].grad.norm() < 1e-4


def test_same_bytes_with_one_and_two_threads() -> None:
    import numba

    arrays, view = scene("usual", 4), RenderView.from_camera(camera(), NEAR, FAR)
    results = []
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        tensors = [torch.tensor(array, requires_grad=True) for array in arrays]
        r = render(*tensors, 3, view, distortion=True)
        (r.color.sum() + r.depth.sum() + r.distortion.sum()).backward()
        results.append([r.color.detach().numpy().tobytes()] + [tensor.grad.numpy().tobytes() for tensor in tensors])
    assert results[0] == results[1]


def test_inactive_tiles_stay_empty_and_give_no_gradient() -> None:
    active = np.zeros((3, 3), bool)
    active[1, 1] = True
    tensors = [torch.tensor(array, requires_grad=True) for array in scene("usual", 0)]
    r = render(*tensors, 0, RenderView.from_camera(camera(), NEAR, FAR, active))
    assert r.alpha[16:32, 16:32].max() > 0 and r.alpha[:16].max() == 0 and r.alpha[:, 32:].max() == 0
    r.alpha[:16].sum().backward()
    assert all(torch.all(tensor.grad == 0) for tensor in tensors)


def test_no_surfel_gives_an_empty_image() -> None:
    empty = [torch.zeros(shape) for shape in ((0, 3), (0, 2), (0, 4), (0,), (0, 16, 3))]
    assert render(*empty, 3, RenderView.from_camera(camera(), NEAR, FAR)).alpha.abs().sum() == 0


@pytest.mark.parametrize("kind", ["usual", "huge", "opaque"])
def test_surface_depth_lies_between_the_median_and_the_mean_of_all_disks(kind: str) -> None:
    tensors, view = [torch.tensor(array) for array in scene(kind, 2)], RenderView.from_camera(camera(), NEAR, FAR)
    drawn = render(*tensors, 0, view)
    median, hit = drawn.median_depth.numpy(), drawn.median_depth.numpy() > 0
    assert hit.mean() > 0.1, "the scene must show something"
    nearest, alpha = render_surface_depth(*tensors[:4], view, reach=1e-5)
    assert np.array_equal(nearest > 0, hit) and np.allclose(nearest[hit], median[hit], atol=2e-5)
    assert np.allclose(alpha, drawn.alpha.numpy(), atol=1e-6)
    some, _ = render_surface_depth(*tensors[:4], view, reach=0.1)
    assert np.abs(some - median)[hit].max() <= 0.1 + 1e-5
    assert np.abs(some - median)[hit].max() > 1e-3, "disks near the median count, too"
    every, _ = render_surface_depth(*tensors[:4], view, reach=1e9)
    assert np.allclose(every[hit], (drawn.depth / drawn.alpha).numpy()[hit], rtol=1e-4)
