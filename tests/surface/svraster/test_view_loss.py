"""The terms of sparse voxels' loss against their definitions, sample by sample along every ray, in float64: values and gradients."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from helpers.ssim_twin import ssim_map
from zeroshop_steps.geometry.cameras.pinhole import Camera
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.train import view_loss
from zeroshop_steps.surface.training import losses
from zeroshop_steps.surface.training.losses import depth_loss

HEIGHT_PX, WIDTH_PX, SAMPLES = 14, 16, 4
FOCAL_PX = 30.0


@pytest.fixture(autouse=True)
def readable_similarity(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing but these tests is in float64: the fast one, which has tests of its own, would be compiled for them alone."""
    monkeypatch.setattr(losses, "dssim", lambda image, target, weight: ((1 - ssim_map(image, target)) * weight).sum())


@pytest.fixture
def view() -> TrainingView:
    rng = np.random.default_rng(1)
    k = np.array([[FOCAL_PX, 0, WIDTH_PX / 2], [0, FOCAL_PX, HEIGHT_PX / 2], [0, 0, 1]])
    active = torch.from_numpy(rng.random((HEIGHT_PX, WIDTH_PX)) < 0.8)
    color, mask = (torch.from_numpy(rng.random(shape)) for shape in ((3, HEIGHT_PX, WIDTH_PX), (HEIGHT_PX, WIDTH_PX)))
    return TrainingView(Camera("a.png", WIDTH_PX, HEIGHT_PX, k, np.eye(4)), color, mask, active, np.ones((1, 1), bool))


def samples() -> tuple[torch.Tensor, ...]:
    """Opacities, colours, unit normals and depths of the samples along every ray, the nearest first."""
    rng = np.random.default_rng(2)
    shape = (SAMPLES, HEIGHT_PX, WIDTH_PX)
    opacity, color = torch.from_numpy(rng.uniform(0.1, 0.7, shape)), torch.from_numpy(rng.random((SAMPLES, 3, HEIGHT_PX, WIDTH_PX)))
    normal = F.normalize(torch.from_numpy(rng.normal(size=(SAMPLES, 3, HEIGHT_PX, WIDTH_PX))), dim=1)
    depth = torch.from_numpy(np.sort(rng.uniform(2.0, 3.0, shape), axis=0))
    return tuple(values.requires_grad_() for values in (opacity, color, normal, depth))


def weights_of(opacity: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Blending weights, and the light that is left at the end."""
    left = torch.cumprod(torch.cat([torch.ones_like(opacity[:1]), 1 - opacity]), dim=0)
    return opacity * left[:-1], left[-1]


def away_from(normal: torch.Tensor) -> torch.Tensor:
    """max(cos, 0) between the rays, through the pixels' centres, and the normals."""
    y, x = torch.meshgrid(torch.arange(HEIGHT_PX) + 0.5, torch.arange(WIDTH_PX) + 0.5, indexing="ij")
    rays = torch.stack([(x - WIDTH_PX / 2) / FOCAL_PX, (y - HEIGHT_PX / 2) / FOCAL_PX, torch.ones_like(x)]).double()
    return (normal * F.normalize(rays, dim=0)).sum(1).clamp(min=0)


def rendering(opacity: torch.Tensor, color: torch.Tensor, normal: torch.Tensor, depth: torch.Tensor) -> SimpleNamespace:
    """The planes that the renderer gives, which its own tests hold to their definitions."""
    weight, _ = weights_of(opacity)
    return SimpleNamespace(
        color=(weight[:, None] * color).sum(0),
        alpha=weight.sum(0),
        color_square=(weight * color.square().sum(1)).sum(0),
        away=(weight * away_from(normal)).sum(0),
        normal=(weight[:, None] * normal).sum(0),
        depth=(weight * depth).sum(0),
        median_depth=depth[1],
    )


def definition(name: str, view: TrainingView, opacity: torch.Tensor, color: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """A term before its weight, as the paper has it."""
    weight, left = weights_of(opacity)
    per_pixel = {
        "transmittance": left**2 * (1 - left) ** 2,
        "color": sum(w * ((c - view.color) ** 2).sum(0) for w, c in zip(weight, color, strict=True)),
        "away": sum(w * a for w, a in zip(weight, away_from(normal), strict=True)),
        "mask": ((1 - left) - view.mask).abs(),
    }[name]
    return per_pixel[view.active].mean()


@pytest.mark.parametrize(("name", "weight"), [("transmittance", 0.7), ("color", 0.3), ("away", 0.2), ("mask", 0.5)])
def test_a_term_is_what_it_is_defined_as(view, name, weight):
    settings = VoxelSettings(lambda_transmittance=0.7, lambda_color=0.3, lambda_ascending=0.2, lambda_mask=0.5)
    inputs = samples()
    found = view_loss(rendering(*inputs), view, settings, with_normals=False)[name]
    expected = weight * definition(name, view, *inputs[:3])
    assert found.item() == pytest.approx(expected.item(), rel=1e-9)
    gradients, wanted = (torch.autograd.grad(value, inputs[:3], allow_unused=True) for value in (found, expected))
    for one, other in zip(gradients, wanted, strict=True):
        assert (one is None or not one.any()) if other is None else torch.allclose(one, other, rtol=1e-7, atol=1e-12)


def test_a_pixel_that_the_mask_is_not_sure_of_does_not_count(view):
    """Losses of a view whose mask is wrong in its left half, and not sure there, are those of its right half."""
    settings, drawn = VoxelSettings(lambda_dssim=0.0, lambda_transmittance=0.7), rendering(*samples())
    right = torch.arange(WIDTH_PX).expand(HEIGHT_PX, WIDTH_PX) >= WIDTH_PX // 2
    unsure = replace(view, mask=torch.where(right, view.mask, 1.0 - view.mask), confidence=right.double())
    half = replace(view, active=view.active & right)
    for name, term in view_loss(drawn, unsure, settings, with_normals=False).items():
        assert term.item() == pytest.approx(view_loss(drawn, half, settings, with_normals=False)[name].item(), rel=1e-9), name


def test_normals_that_fit_the_depth_cost_nothing_and_turned_ones_twice(view):
    flat = torch.full((HEIGHT_PX, WIDTH_PX), 2.5, dtype=torch.float64)
    towards = torch.zeros(3, HEIGHT_PX, WIDTH_PX, dtype=torch.float64)
    towards[2] = -1.0
    inner = torch.zeros(HEIGHT_PX, WIDTH_PX, dtype=torch.bool)
    inner[1:-1, 1:-1] = True  # the outermost pixels have no normal of the depth
    view = replace(view, active=view.active & inner)
    drawn = rendering(*samples())
    drawn.alpha, drawn.median_depth = torch.ones_like(flat), flat
    losses = []
    for normal in (towards, -towards):
        drawn.normal = normal
        losses.append(view_loss(drawn, view, VoxelSettings(lambda_normal=0.4), with_normals=True)["normal"].item())
    assert losses == [pytest.approx(0.0, abs=1e-12), pytest.approx(2 * 0.4)]


def test_depth_counts_where_it_was_confirmed(view):
    drawn = rendering(*samples())
    pixels = torch.tensor([5, 40, 41])
    confirmed = torch.tensor([2.2, 2.4, 2.9], dtype=torch.float64)
    weights = torch.tensor([1.0, 0.25, 0.0], dtype=torch.float64)
    expected = (((drawn.depth / drawn.alpha).reshape(-1)[pixels] - confirmed).abs() * weights).sum() / view.active.sum()
    assert depth_loss(drawn, pixels, confirmed, weights, view.active.sum()).item() == pytest.approx(expected.item(), rel=1e-9)
    assert depth_loss(drawn, pixels[:0], confirmed[:0], weights[:0], view.active.sum()).item() == 0.0
