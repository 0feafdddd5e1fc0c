"""SVRaster (Sun et al. 2025): train sparse voxels on the masked, registered images of an object.

Writes voxels.npz, training.csv (the loss by term) and training.json (settings and figures). During training, checkpoint.pt
lies beside them; --resume continues from it.
"""

import argparse

from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.surface.svraster.settings import OPTIONS, VoxelSettings
from zeroshop_steps.surface.training.training_options import add_setting_arguments, add_training_arguments, chosen_settings

CACHED = Cached(
    inputs=("cameras/images", "cameras/masks", "cameras/confidence", "cameras/sparse", "stereo"),
    ignored=("threads", "resume", "checkpoint_every"),
    outputs=("training.csv", "training.json", "voxels.npz"),
)

METHOD = {
    "title": "SVRaster",
    "rank": 1,
    "model": "voxels/voxels.npz",
    "mesh": "svraster_mesh",
    "rules": ("train_svraster", "mesh_svraster"),
    "options": ("train", "mesh"),
    "mem_mb": 6000,
    # A voxel: parameters, gradients, moments, rows and its place in the tree, 0.8 kB, more with a higher degree of the colour, and two or
    # three tiles of 0.13 kB. A pixel as for 2DGS.
    "gpu_bytes": {"primitive": 2000, "pixel": 1500},
    "runtime_min": 60,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_training_arguments(parser, "voxels.npz", VoxelSettings.iterations, image_width_px=500, sh_degree=VoxelSettings.sh_degree)
    add_setting_arguments(parser, VoxelSettings, OPTIONS)


def run(args: argparse.Namespace) -> None:
    from zeroshop_steps.runtime.errors import StepError
    from zeroshop_steps.surface.rendering.training_views import make_grid_view
    from zeroshop_steps.surface.svraster.initialization import initialize_voxels
    from zeroshop_steps.surface.svraster.train import VoxelTrainer
    from zeroshop_steps.surface.svraster.voxels import Voxels, write_voxels
    from zeroshop_steps.surface.training.initialization import Initialization
    from zeroshop_steps.surface.training.training_run import PRIMITIVES_MIN, TrainingInputs, train_model

    settings = VoxelSettings(**chosen_settings(args, OPTIONS))

    def initialize(initialization: Initialization, inputs: TrainingInputs) -> Voxels:
        small = [make_grid_view(view) for view in inputs.seed_views]
        voxels = initialize_voxels(initialization, small, settings)
        if len(voxels) < PRIMITIVES_MIN:
            raise StepError(f"the masks of {args.cameras} leave {len(voxels)} voxels: masks and cameras do not agree; look at both")
        return voxels

    train_model(
        args,
        step="surface.svraster",
        method="svraster",
        trainer_class=VoxelTrainer,
        settings=settings,
        hull_points=0,
        initialize=initialize,
        write=lambda voxels, sphere: write_voxels(args.out / "voxels.npz", voxels, sphere),
    )
