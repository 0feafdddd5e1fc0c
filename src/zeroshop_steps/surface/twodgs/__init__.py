"""2D Gaussian Splatting (Huang et al. 2024): train planar disks on the masked, registered images of an object.

Writes splats.ply (opened by common splat viewers), training.csv (the loss by term) and training.json (settings,
figures). While it trains, checkpoint.pt is kept beside them; --resume goes on from there.
"""

import argparse
import time

from zeroshop_steps.runtime.cache import Cached
from zeroshop_steps.surface.training_options import add_training_arguments

HULL_POINTS = 4000
CACHED = Cached(
    inputs=("cameras/images", "cameras/masks", "cameras/sparse", "stereo"),
    ignored=("threads", "resume", "checkpoint_every"),
    outputs=("training.csv", "training.json", "splats.ply"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_training_arguments(parser, "splats.ply", iterations=800, image_width_px=800, sh_degree=2)


def run(args: argparse.Namespace) -> None:
    from zeroshop_steps.runtime.errors import StepError
    from zeroshop_steps.runtime.threads import use_threads
    from zeroshop_steps.surface.initialization import make_initialization
    from zeroshop_steps.surface.trainer import CHECKPOINT, TrainingInputs, write_record
    from zeroshop_steps.surface.twodgs.surfels import initialize_surfels, write_splat_ply
    from zeroshop_steps.surface.twodgs.train import SurfelSettings, SurfelTrainer

    threads = use_threads(args.threads)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    inputs = TrainingInputs.read(args, "surface.twodgs")
    views, identity = inputs.views, inputs.identity
    settings = SurfelSettings(iterations=args.iterations, sh_degree=args.sh_degree, seed=args.seed)
    checkpoint = args.out / CHECKPOINT
    initialization = make_initialization(inputs.camera_set.model, inputs.sphere, inputs.seed_views, inputs.seeds, HULL_POINTS, args.seed)
    trainer = SurfelTrainer.resume(checkpoint, views, initialization, settings, identity) if args.resume and checkpoint.exists() else None
    resumed_from = trainer.iteration if trainer else 0
    if trainer is None:
        trainer = SurfelTrainer(initialize_surfels(initialization, args.seed), views, initialization, settings)
    trainer.run_with_checkpoints(args.checkpoint_every, checkpoint, identity, args.cameras)
    if len(trainer.surfels) < 10:
        raise StepError(f"training on {args.cameras} left {len(trainer.surfels)} disks: masks and cameras do not agree; look at both")

    write_splat_ply(args.out / "splats.ply", trainer.surfels, inputs.sphere)
    seconds = time.monotonic() - start_s, time.process_time() - start_cpu_s
    write_record(args, trainer, "2dgs", threads, resumed_from, seconds)
