"""Trainings of a few surfels or voxels on two tiny views, on any device: so short that the simulator can do them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch

from helpers.ball import ball_view
from zeroshop_steps.surface.svraster.octree import Octree
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.train import VoxelTrainer
from zeroshop_steps.surface.svraster.voxels import Voxels
from zeroshop_steps.surface.training.trainer import Trainer, ViewPyramid
from zeroshop_steps.surface.twodgs.settings import SurfelSettings
from zeroshop_steps.surface.twodgs.surfels import Surfels
from zeroshop_steps.surface.twodgs.train import SurfelTrainer

STEPS, COUNT, SIZE_PX = 2, 8, 10
EARLY = {"iterations": STEPS, "normal_from_share": 0.0, "coarse_share": 0.0}
"""All terms of the loss count from the first step on, and the number of primitives changes before the last."""


def make_inputs() -> tuple[ViewPyramid, SimpleNamespace]:
    """Two views of one tile, and depths that are known in each."""
    rng = np.random.default_rng(3)
    views = [replace(ball_view(azimuth, 20.0, SIZE_PX, 1.0)[0], tile_active=np.ones((1, 1), bool)) for azimuth in (40.0, 60.0)]
    known = {view.camera.name: rng.uniform(-0.1, 0.1, (4, 2)) for view in views}
    depths = {name: rng.uniform(1.9, 2.1, 4) for name in known}
    free_space = SimpleNamespace(contains=lambda points: np.arange(len(points)) == 1)
    weights = {name: np.full(len(depth), 0.5, np.float32) for name, depth in depths.items()}
    start = SimpleNamespace(confirmed_rays=known, confirmed_depths=depths, confirmed_weights=weights, free_space=free_space)
    return ViewPyramid(views, views), start


def make_surfel_trainer(device: str) -> SurfelTrainer:
    rng = np.random.default_rng(5)
    settings = SurfelSettings(
        **EARLY,
        lambda_distortion=10.0,
        densify_every=1,
        densify_until_share=1.0,
        densify_gradient=1e-3,
        opacity_reset_share=1.0,
        device=device,
    )
    sizes = {"positions": (3,), "log_scales": (2,), "quaternions": (4,), "opacity_logits": (), "sh_constant": (1, 3), "sh_rest": (15, 3)}
    tensors = {name: torch.tensor(0.3 * rng.normal(size=(COUNT, *size)), dtype=torch.float32) for name, size in sizes.items()}
    tensors["log_scales"] -= 2.0
    return SurfelTrainer(Surfels(**tensors), *make_inputs(), settings)


def make_voxel_trainer(device: str) -> VoxelTrainer:
    rng = np.random.default_rng(5)
    octree = Octree.uniform(np.ones((2, 2, 2), bool))
    octree, _ = octree.refine(np.arange(8) != 5, np.arange(8) == 2)
    densities = torch.tensor(rng.normal(-3.0, 1.0, octree.corner_count), dtype=torch.float32)
    constant, rest = (torch.tensor(0.3 * rng.normal(size=(len(octree), k, 3)), dtype=torch.float32) for k in (1, 3))
    settings = VoxelSettings(**EARLY, adapt_shares=(0.5,), count_max=25, device=device)
    return VoxelTrainer(Voxels(octree, densities, constant, rest), *make_inputs(), settings)


def trained(trainer: Trainer) -> dict[str, np.ndarray]:
    """By names that begin with "trained_": the loss of each step, the number of primitives before, and the tensors at the end."""
    count = len(trainer.model)
    losses = np.array([trainer.step() for _ in range(STEPS)])
    tensors = {name: tensor.detach().cpu().numpy() for name, tensor in trainer.model.tensors().items()}
    return {f"trained_{name}": value for name, value in ({"losses": losses, "count": np.array(count)} | tensors).items()}


def check(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    """The same losses, and the same primitives after their number has changed, as on the CPU."""
    assert len(expected["trained_sh_rest"]) != expected["trained_count"] and np.ptp(expected["trained_losses"]) > 0
    for name, value in expected.items():
        assert found[name].shape == value.shape, name
        assert np.linalg.norm(found[name] - value) < 1e-3 * np.linalg.norm(value), name
