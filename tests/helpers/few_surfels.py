"""A training of a few surfels on two tiny views, on any device: a few steps with densification, so short that the simulator can do it."""

from types import SimpleNamespace

import numpy as np
import torch

from helpers.ball import ball_view
from zeroshop_steps.surface.trainer import ViewPyramid
from zeroshop_steps.surface.twodgs.settings import SurfelSettings
from zeroshop_steps.surface.twodgs.surfels import Surfels
from zeroshop_steps.surface.twodgs.train import SurfelTrainer

STEPS, COUNT, SIZE_PX = 3, 10, 16


def make_trainer(device: str) -> SurfelTrainer:
    """Training that compares normals, distortion and depths from the first step on, and densifies after the second."""
    rng = np.random.default_rng(3)
    views = [ball_view(azimuth, 20.0, SIZE_PX, 1.0)[0] for azimuth in (0.0, 70.0)]
    settings = SurfelSettings(
        iterations=STEPS,
        normal_from_share=0.0,
        coarse_share=0.0,
        lambda_distortion=10.0,
        densify_every=2,
        densify_until_share=1.0,
        densify_gradient=1e-3,
        opacity_reset_share=1.0,
        device=device,
    )
    known = {view.camera.name: rng.uniform(-0.1, 0.1, (4, 2)) for view in views}
    depths = {name: rng.uniform(1.9, 2.1, 4) for name in known}
    free_space = SimpleNamespace(contains=lambda points: np.arange(len(points)) == 1)
    initialization = SimpleNamespace(confirmed_rays=known, confirmed_depths=depths, free_space=free_space)
    sizes = {"positions": (3,), "log_scales": (2,), "quaternions": (4,), "opacity_logits": (), "sh_constant": (1, 3), "sh_rest": (15, 3)}
    tensors = {name: torch.tensor(0.3 * rng.normal(size=(COUNT, *size)), dtype=torch.float32) for name, size in sizes.items()}
    tensors["log_scales"] -= 2.0
    return SurfelTrainer(Surfels(**tensors), ViewPyramid(views, views), initialization, settings)


def train(device: str) -> dict[str, np.ndarray]:
    """The loss of each step, and the surfels at the end."""
    trainer = make_trainer(device)
    losses = np.array([trainer.step() for _ in range(STEPS)])
    return {"losses": losses} | {name: tensor.detach().cpu().numpy() for name, tensor in trainer.model.tensors().items()}
