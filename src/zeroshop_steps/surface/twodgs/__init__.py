"""2D Gaussian Splatting (Huang et al. 2024): train surfels, planar Gaussian disks, on the masked and registered images of an object.

Writes splats.ply, which common splat viewers open, training.csv (the loss by term) and training.json (settings and
figures). During training, checkpoint.pt lies beside them; --resume continues from it.
"""

import argparse

from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.surface.training.training_options import add_setting_arguments, add_training_arguments, chosen_settings
from zeroshop_steps.surface.twodgs.settings import OPTIONS, SurfelSettings

HULL_POINTS = 4000
"""Points of the carved hull that the surfels start from, at most, where stereo has found nothing."""
CACHED = Cached(
    inputs=("cameras/images", "cameras/masks", "cameras/confidence", "cameras/sparse", "stereo"),
    ignored=("threads", "resume", "checkpoint_every"),
    outputs=("training.csv", "training.json", "splats.ply"),
)

METHOD = {
    "name": "2dgs",
    "title": "2DGS",
    "rank": 0,
    "model": "splats/splats.ply",
    "mesh": "fuse",
    "rules": ("train_2dgs", "fuse_2dgs"),
    "options": ("train", "fuse"),
    "mem_mb": 6000,
    # A surfel: parameters, gradients, moments and rows, 1.8 kB, and about nine tiles of 0.14 kB. A pixel: planes, their gradients, the
    # maps of the losses, 1 kB, and twenty photos. The rest is what PyTorch's allocator keeps.
    "gpu_bytes": {"primitive": 4000, "pixel": 1500},
    "runtime_min": 60,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_training_arguments(parser, "splats.ply", SurfelSettings.iterations, image_width_px=800, sh_degree=SurfelSettings.sh_degree)
    add_setting_arguments(parser, SurfelSettings, OPTIONS)


def run(args: argparse.Namespace) -> None:
    from zeroshop_steps.surface.training.training_run import train_model
    from zeroshop_steps.surface.twodgs.surfels import initialize_surfels, write_splat_ply
    from zeroshop_steps.surface.twodgs.train import SurfelTrainer

    train_model(
        args,
        step="surface.twodgs",
        method="2dgs",
        trainer_class=SurfelTrainer,
        settings=SurfelSettings(**chosen_settings(args, OPTIONS)),
        hull_points=HULL_POINTS,
        initialize=lambda initialization, _: initialize_surfels(initialization, args.seed),
        write=lambda surfels, sphere: write_splat_ply(args.out / "splats.ply", surfels, sphere),
    )
