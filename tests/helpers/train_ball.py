"""Train both optimizers for a few steps on a small ball and print a digest of what comes out; the argument is the number of threads."""

import hashlib
import sys

import numpy as np
import torch

from helpers.ball import ball_initialization, ball_views
from zeroshop_steps.runtime.compute.threads import use_threads
from zeroshop_steps.surface.fuse import fuse_depth_maps, render_depth
from zeroshop_steps.surface.svraster.initialization import initialize_voxels
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.train import VoxelTrainer
from zeroshop_steps.surface.training.trainer import ViewPyramid
from zeroshop_steps.surface.twodgs.settings import SurfelSettings
from zeroshop_steps.surface.twodgs.surfels import initialize_surfels
from zeroshop_steps.surface.twodgs.train import SurfelTrainer

STEPS = 25
SIZE_PX = 61
"""No multiple of a vector's length: the last pixels of a row are worked out by other machine code than the rest."""


def digest_of(values: torch.Tensor | np.ndarray) -> str:
    """The SHA-256 of an array's bytes."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def train(threads: int) -> None:
    """Print one line per result."""
    use_threads(threads)
    views, _ = ball_views(SIZE_PX)
    start, pyramid = ball_initialization(views), ViewPyramid(views, views)
    settings = SurfelSettings(iterations=STEPS, densify_every=10, densify_from_share=0.2)
    surfels = SurfelTrainer(initialize_surfels(start, settings.seed), pyramid, start, settings)
    surfels.run(STEPS)
    for name, tensor in surfels.model.tensors().items():
        setattr(surfels.model, name, tensor.detach())
        print("2dgs", name, digest_of(tensor.detach().numpy()))
    mesh = fuse_depth_maps([render_depth(surfels.model, view) for view in views], views, surfels.model, voxels=32, min_views=2)
    print("2dgs mesh", digest_of(mesh.vertices), digest_of(mesh.faces))
    choices = VoxelSettings(level_start=4, level_max=6, iterations=STEPS, adapt_shares=(0.4,), count_max=4000)
    voxels = VoxelTrainer(initialize_voxels(start, views, choices), pyramid, start, choices)
    voxels.run(STEPS)
    for name, tensor in voxels.model.tensors().items():
        print("svraster", name, digest_of(tensor.detach().numpy()))


if __name__ == "__main__":
    train(int(sys.argv[1]))
