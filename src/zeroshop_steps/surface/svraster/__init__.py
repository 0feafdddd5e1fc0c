"""SVRaster (Sun et al. 2025): train sparse voxels on the masked, registered images of an object.

Writes voxels.npz, training.csv (the loss by term) and training.json (settings, figures). While it trains, checkpoint.pt
is kept beside them; --resume goes on from there.
"""

import argparse
import time

from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.surface.svraster.settings import LOSSES, VoxelSettings
from zeroshop_steps.surface.training_options import add_training_arguments

CACHED = Cached(
    inputs=("cameras/images", "cameras/masks", "cameras/sparse", "stereo"),
    ignored=("threads", "resume", "checkpoint_every"),
    outputs=("training.csv", "training.json", "voxels.npz"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_training_arguments(parser, "voxels.npz", iterations=VoxelSettings.iterations, image_width_px=500, sh_degree=1)
    for name, text in LOSSES.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=getattr(VoxelSettings, name), help=text)


def run(args: argparse.Namespace) -> None:
    from zeroshop_steps.runtime.errors import StepError
    from zeroshop_steps.runtime.threads import use_threads
    from zeroshop_steps.surface.initialization import make_initialization
    from zeroshop_steps.surface.svraster.initialization import initialize_voxels
    from zeroshop_steps.surface.svraster.train import VoxelTrainer
    from zeroshop_steps.surface.svraster.voxels import write_voxels
    from zeroshop_steps.surface.trainer import CHECKPOINT, TrainingInputs, write_record
    from zeroshop_steps.surface.training_views import make_grid_view

    threads = use_threads(args.threads)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    inputs = TrainingInputs.read(args, "surface.svraster")
    views, identity = inputs.views, inputs.identity
    weights = {name: getattr(args, name) for name in LOSSES}
    settings = VoxelSettings(iterations=args.iterations, sh_degree=args.sh_degree, seed=args.seed, **weights)
    checkpoint = args.out / CHECKPOINT
    initialization = make_initialization(inputs.camera_set.model, inputs.sphere, inputs.seed_views, inputs.seeds, 0, args.seed)
    trainer = VoxelTrainer.resume(checkpoint, views, initialization, settings, identity) if args.resume and checkpoint.exists() else None
    resumed_from = trainer.iteration if trainer else 0
    if trainer is None:
        small = [make_grid_view(view) for view in inputs.seed_views]
        voxels = initialize_voxels(initialization, small, settings.level_start, settings.sh_degree)
        if len(voxels) < 10:
            raise StepError(f"the masks of {args.cameras} leave {len(voxels)} voxels: masks and cameras do not agree; look at both")
        trainer = VoxelTrainer(voxels, views, initialization, settings)
    trainer.run_with_checkpoints(args.checkpoint_every, checkpoint, identity, args.cameras)
    if len(trainer.voxels) < 10:
        raise StepError(f"training on {args.cameras} left {len(trainer.voxels)} voxels: masks and cameras do not agree; look at both")

    write_voxels(args.out / "voxels.npz", trainer.voxels, inputs.sphere)
    seconds = time.monotonic() - start_s, time.process_time() - start_cpu_s
    write_record(args, trainer, "svraster", threads, resumed_from, seconds)
