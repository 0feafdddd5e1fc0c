"""From coarse views to fine ones, with confirmed depths, by both optimizers: what their own tests leave out."""

from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.ball import ball_initialization, ball_views
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.initialization import initialize_voxels
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.train import VoxelTrainer
from zeroshop_steps.surface.training.initialization import Initialization
from zeroshop_steps.surface.training.trainer import Trainer, ViewPyramid, find_depth_targets
from zeroshop_steps.surface.twodgs.settings import SurfelSettings
from zeroshop_steps.surface.twodgs.surfels import initialize_surfels
from zeroshop_steps.surface.twodgs.train import SurfelTrainer

ITERATIONS, SWITCH = 24, 12


@pytest.fixture(scope="module")
def sizes() -> tuple[ViewPyramid, list[np.ndarray]]:
    """The ball at 32 and 64 px, and its depth maps at 64 px."""
    fine, depths = ball_views(64)
    return ViewPyramid(ball_views(32)[0], fine), depths


def confirmed_initialization(views: list[TrainingView], depths: list[np.ndarray], step_px: int = 5) -> Initialization:
    """The ball's start, with the exact depth of every few pixels."""
    initialization = ball_initialization(views)
    for view, depth in zip(views, depths, strict=True):
        k = view.camera.intrinsics
        y, x = (grid.ravel() for grid in np.mgrid[2 : len(depth) : step_px, 2 : len(depth) : step_px])
        y, x = y[depth[y, x] > 0], x[depth[y, x] > 0]
        initialization.confirmed_rays[view.camera.name] = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1]], 1)
        initialization.confirmed_depths[view.camera.name] = depth[y, x]
    return initialization


def trainer_of(method: str, views: ViewPyramid, initialization: Initialization) -> Trainer:
    if method == "svraster":
        settings = VoxelSettings(iterations=ITERATIONS, coarse_share=SWITCH / ITERATIONS, level_start=4, level_max=6)
        return VoxelTrainer(initialize_voxels(initialization, views.fine, settings), views, initialization, settings)
    settings = SurfelSettings(iterations=ITERATIONS, coarse_share=SWITCH / ITERATIONS)
    return SurfelTrainer(initialize_surfels(initialization, 0), views, initialization, settings)


def test_a_confirmed_depth_is_anchored_at_the_pixel_that_shows_it(sizes):
    views, depths = sizes
    initialization = confirmed_initialization(views.fine, depths)
    for view, coarse, depth in zip(views.fine, views.coarse, depths, strict=True):
        pixels, confirmed, _ = find_depth_targets(view, initialization)
        assert len(pixels) > 20 and np.array_equal(depth.reshape(-1)[pixels.numpy()], confirmed.numpy())
        pixels, confirmed, _ = find_depth_targets(coarse, initialization)
        y, x = np.divmod(pixels.numpy(), 32)
        around = np.stack([depth[2 * y + dy, 2 * x + dx] for dy in (0, 1) for dx in (0, 1)])
        assert (np.abs(around - confirmed.numpy()).min(axis=0) == 0).all(), "the coarse pixel is the one that covers the fine one"


@pytest.mark.parametrize("method", ["2dgs", pytest.param("svraster", marks=pytest.mark.slow)])
def test_training_goes_from_coarse_to_fine_and_resumes_on_either_side(method, sizes, tmp_path: Path):
    views, depths = sizes
    initialization = confirmed_initialization(views.fine, depths)
    whole = trainer_of(method, views, initialization)
    whole.run(SWITCH)
    assert whole.views is views.coarse
    whole.run(ITERATIONS)
    assert whole.views is views.fine
    terms = whole.losses(whole.render(0, 0), 0, 1.0)
    assert terms["depth"] > 0
    terms["depth"].backward()
    assert any(tensor.grad is not None and tensor.grad.any() for tensor in whole.model.tensors().values())
    for stop in (SWITCH - 5, SWITCH + 5):
        first = trainer_of(method, views, initialization)
        first.run(stop)
        first.save(tmp_path / "checkpoint.pt", {})
        second = type(first).resume(tmp_path / "checkpoint.pt", views, initialization, first.settings, {})
        second.run(ITERATIONS)
        for name, tensor in whole.model.tensors().items():
            assert torch.equal(tensor, second.model.tensors()[name]), (stop, name)
