"""The CPU kernels of sparse voxels against the float64 autograd twin: values and gradients, over random and degenerate scenes."""

import functools

import numpy as np
import pytest
import torch

from helpers.quick import first
from voxel_reference import render_reference
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.rendering.tiling import STOP, TILE_PX
from zeroshop_steps.surface.svraster.octree import CELLS, MAX_LEVEL, Octree
from zeroshop_steps.surface.svraster.render import RenderView, render

WIDTH_PX, HEIGHT_PX = 24, 20
KINDS = ["usual", "straddling", "grazing", "inside", "tiny", "huge", "transparent", "opaque"]


def camera(kind: str = "usual") -> Camera:
    rng = np.random.default_rng(5)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    k = np.array([[36.0, 0, 12.6], [0, 34.0, 9.4], [0, 0, 1]])
    translation = np.array([0.1, -0.05, 3.0])
    if kind in ("straddling", "grazing", "inside"):
        # Rays of all signs across two axes. Grazing ones run along the voxels' faces, up to a thousandth of a pixel.
        rotation = np.eye(3)[[1, 2, 0]]
    if kind == "grazing":
        k[:2, 2] = [12.501, 9.499]
        translation = np.array([0.0, 0.0, 3.0])
    if kind == "inside":
        translation = np.array([0.02, -0.03, 0.11])
    if kind == "tiny":
        k[:2, :2] *= 100.0
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = rotation, translation
    return Camera("view", WIDTH_PX, HEIGHT_PX, k, camera_from_world)


def scene(kind: str, seed: int) -> tuple[Octree, np.ndarray, np.ndarray]:
    """Leaves of several levels side by side, values at their corners, and spherical harmonics."""
    rng = np.random.default_rng(seed)
    octree = Octree.uniform(rng.uniform(size=(4, 4, 4)) < 0.8)
    if kind == "huge":
        octree = Octree.uniform(np.ones((1, 1, 1), bool))
    for _ in range(3):
        middle = np.abs(octree.centres).max(1) < octree.sizes
        chosen = rng.uniform(size=len(octree)) < (1.0 if kind == "tiny" else 0.25)
        chosen[len(octree) // 2] = True
        octree, _ = octree.refine(rng.uniform(size=len(octree)) < 0.95, chosen & (middle if kind == "tiny" else True))
    if kind == "tiny":
        for _ in range(5):
            middle = np.abs(octree.centres).max(1) < 1.5 * octree.sizes
            octree, _ = octree.refine(np.ones(len(octree), bool), middle)
    values = rng.normal(-2.0, 1.5, octree.corner_count)
    if kind == "tiny":
        values += 5.0
    if kind == "transparent":
        values[::2] = -15.0
    if kind == "opaque":
        values += 6.0
    return octree, values.astype(np.float32), (rng.normal(size=(len(octree), 16, 3)) * 0.4).astype(np.float32)


@functools.cache
def both(kind: str, seed: int, degree: int = 3) -> tuple[tuple, tuple]:
    """The planes, the parameters with their gradients, and the statistics, of the kernels and of the twin."""
    octree, *arrays = scene(kind, seed)
    view = RenderView.from_camera(camera(kind))
    ours = [torch.tensor(array, requires_grad=True) for array in arrays]
    r = render(octree, *ours, degree, view)
    mine = torch.cat([r.color, r.depth[None], r.normal, *(p[None] for p in (r.alpha, r.median_depth, r.color_square, r.away))])
    twins = [torch.tensor(array.astype(np.float64), requires_grad=True) for array in arrays]
    kept: dict[str, torch.Tensor] = {}
    theirs, undecided = render_reference(octree, *twins, degree, torch.tensor(view.camera), WIDTH_PX, HEIGHT_PX, view.near, kept)
    weights = torch.tensor(np.random.default_rng(1).normal(size=theirs.shape))
    assert undecided.double().mean() < 0.1, "most pixels must be compared"
    weights[:, undecided] = 0.0
    theirs, mine = theirs * ~undecided, mine * ~undecided
    (theirs * weights).sum().backward()
    (mine * weights.float()).sum().backward()
    return (mine, ours, r.statistics), (theirs, twins, kept)


@pytest.mark.parametrize("kind", first(4, KINDS))
@pytest.mark.parametrize("seed", first(1, [0, 1]))
def test_values_and_gradients_match_the_float64_twin(kind: str, seed: int) -> None:
    (mine, ours, _), (theirs, twins, _) = both(kind, seed)
    assert theirs[7].max() > 0.5 and theirs[8].max() > 0, "the scene must show something"
    for plane in range(11):
        error = (mine[plane].double() - theirs[plane]).norm() / theirs[plane].norm().clamp(min=1e-3)
        assert error < 1e-4, f"plane {plane}: relative error {error:.2e}"
    for name, tensor, twin in zip(("densities", "sh"), ours, twins, strict=True):
        assert twin.grad.norm() > 0
        error = (tensor.grad.double() - twin.grad).norm() / twin.grad.norm()
        assert error < 1e-4, f"gradient of {name}: relative error {error:.2e}"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_what_prunes_and_subdivides_matches_the_twin(kind: str) -> None:
    """The largest blending weight, and the sum of |alpha d loss / d alpha| (Sun et al. 2025, sec. 3.2)."""
    (_, _, statistics), (_, twins, kept) = both(kind, 0)
    left = torch.exp(-kept["thickness"].detach())
    priority = ((1 - left) * kept["thickness"].grad / left.clamp(min=float(STOP))).abs().sum(1).numpy()
    assert np.linalg.norm(statistics.priority.numpy() - priority) < 3e-3 * np.linalg.norm(priority)
    # Tiles are drawn whole: where a voxel reaches beyond the image's edge, pixels there may raise its weight.
    view, drawn = RenderView.from_camera(camera(kind)), {}
    width, height = (-(-size // TILE_PX) * TILE_PX for size in (WIDTH_PX, HEIGHT_PX))
    render_reference(scene(kind, 0)[0], *twins, 3, torch.tensor(view.camera), width, height, view.near, drawn)
    beyond = drawn["thickness"].detach().reshape(-1, height, width).clone()
    beyond[:, :HEIGHT_PX, :WIDTH_PX] = 0.0
    largest, whole = kept["weight"].amax(1).numpy(), beyond.amax((1, 2)).numpy() == 0.0
    assert (statistics.weight.numpy() > largest - 2e-4).all()
    assert np.allclose(statistics.weight.numpy()[whole], largest[whole], atol=2e-4) and (
        kind in ("inside", "tiny") or largest[whole].max() > 0.2
    )


def test_scenes_are_what_they_are_called() -> None:
    for kind in KINDS:
        octree, _, _ = scene(kind, 0)
        centre = (camera(kind).centre_in_world + 1.0) * CELLS / 2
        holds = ((octree.origins <= centre) & (centre < octree.origins + octree.cells[:, None])).all(1)
        assert holds.any() == (kind == "inside"), kind
        octants = set(RenderView.from_camera(camera(kind)).tile_octants.octants)
        assert (len(octants) > 1) == (kind in ("straddling", "grazing", "inside")), kind
        assert len(set(octree.levels)) > 2
    assert scene("tiny", 0)[0].levels.max() == MAX_LEVEL and scene("huge", 0)[0].levels.min() <= 1


@pytest.mark.parametrize("degree", first(1, [1, 0, 2]))
def test_lower_degrees_leave_higher_coefficients_alone(degree: int) -> None:
    (_, ours, _), (_, twins, _) = both("usual", 3, degree)
    assert torch.all(ours[1].grad[:, (degree + 1) ** 2 :] == 0)
    assert (ours[0].grad.double() - twins[0].grad).norm() / twins[0].grad.norm() < 1e-4


def test_same_bytes_with_one_and_two_threads() -> None:
    import numba

    octree, *arrays = scene("straddling", 4)
    view, results = RenderView.from_camera(camera("straddling")), []
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        tensors = [torch.tensor(array, requires_grad=True) for array in arrays]
        r = render(octree, *tensors, 3, view)
        (r.color.sum() + r.depth.sum() + r.away.sum()).backward()
        results.append([r.color.detach().numpy().tobytes()] + [tensor.grad.numpy().tobytes() for tensor in tensors])
        results[-1] += [r.statistics.weight.numpy().tobytes(), r.statistics.priority.numpy().tobytes()]
    assert results[0] == results[1]


def test_inactive_tiles_stay_empty_and_give_no_gradient() -> None:
    active = np.zeros((2, 2), bool)
    active[0, 0] = True
    octree, *arrays = scene("usual", 0)
    tensors = [torch.tensor(array, requires_grad=True) for array in arrays]
    r = render(octree, *tensors, 0, RenderView.from_camera(camera(), active))
    assert r.alpha[:16, :16].max() > 0 and r.alpha[16:].max() == 0 and r.alpha[:, 16:].max() == 0
    r.alpha[16:].sum().backward()
    assert all(torch.all(tensor.grad == 0) for tensor in tensors)


def test_no_voxel_gives_an_empty_image() -> None:
    empty = Octree(np.zeros((0, 3), np.int64), np.zeros(0, np.int64))
    assert render(empty, torch.zeros(0), torch.zeros(0, 16, 3), 3, RenderView.from_camera(camera())).alpha.abs().sum() == 0


def test_refined_leaves_render_the_same_where_colours_and_normals_do_not_matter() -> None:
    """Splitting keeps the density field, up to the samples' places within it, when all leaves are split."""
    octree, values, _ = scene("usual", 0)
    octree = Octree.uniform(np.ones((4, 4, 4), bool))
    values = np.full(octree.corner_count, -1.0, np.float32) + 0.01 * octree.corner_points[:, 0].astype(np.float32) / 256
    finer, source = octree.refine(np.ones(64, bool), np.ones(64, bool))
    carried = octree.interpolate(values, finer, source)
    assert len(finer) == 512 and np.allclose(carried, -1.0 + 0.01 * finer.corner_points[:, 0] / 256, atol=1e-5)
    alphas = [
        render(tree, torch.from_numpy(v), torch.zeros(len(tree), 1, 3), 0, RenderView.from_camera(camera())).alpha
        for tree, v in ((octree, values), (finer, carried))
    ]
    assert (alphas[0] - alphas[1]).abs().max() < 1e-4


def test_overlapping_leaves_are_refused() -> None:
    with pytest.raises(StepError, match="overlap"):
        Octree(np.array([[0, 0, 0], [0, 0, 0]]), np.array([0, 1]))
