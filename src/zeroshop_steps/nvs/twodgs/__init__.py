"""2D Gaussian Splatting (Huang et al. 2024): train planar disks on the masked, registered images of an object.

Writes splats.ply (opened by common splat viewers), training.csv (the loss by term) and training.json (settings,
figures). While it trains, checkpoint.pt is kept beside them; --resume goes on from there.
"""

import argparse
import dataclasses
import time

import numpy as np

from zeroshop_steps.cache import Cached
from zeroshop_steps.nvs.options import add_training_arguments

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
    from zeroshop_steps.errors import StepError
    from zeroshop_steps.files import write_json
    from zeroshop_steps.nvs.start import find_start
    from zeroshop_steps.nvs.threads import use_threads
    from zeroshop_steps.nvs.training import TrainingInputs, write_curve
    from zeroshop_steps.nvs.twodgs.surfels import start_surfels, write_splat_ply
    from zeroshop_steps.nvs.twodgs.train import Trainer, TrainingSettings

    threads = use_threads(args.threads)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    inputs = TrainingInputs.read(args)
    views, identity = inputs.views, inputs.identity
    settings = TrainingSettings(iterations=args.iterations, sh_degree=args.sh_degree, seed=args.seed)
    checkpoint = args.out / "checkpoint.pt"
    start = find_start(inputs.camera_set.model, inputs.sphere, inputs.seed_views, inputs.seeds, HULL_POINTS, args.seed)
    trainer = Trainer.resume(checkpoint, views, start, settings, identity) if args.resume and checkpoint.exists() else None
    resumed_from = trainer.iteration if trainer else 0
    if trainer is None:
        trainer = Trainer(start_surfels(start.points, start.colors, start.normals, args.seed), views, start, settings)
    trainer.run_with_checkpoints(args.checkpoint_every, checkpoint, identity, args.cameras)
    if len(trainer.surfels) < 10:
        raise StepError(f"training on {args.cameras} left {len(trainer.surfels)} disks: masks and cameras do not agree; look at both")

    write_splat_ply(args.out / "splats.ply", trainer.surfels, inputs.sphere)
    write_curve(args.out / "training.csv", trainer.history)
    write_json(
        args.out / "training.json",
        {
            "method": "2dgs",
            "seconds": round(time.monotonic() - start_s, 2),
            "cpu_seconds": round(time.process_time() - start_cpu_s, 2),
            "resumed_from_iteration": resumed_from,
            "threads": threads,
            "image_width_px": args.image_width_px,
            "settings": dataclasses.asdict(settings),
            "disks": len(trainer.surfels),
            "psnr_training_db": round(float(np.mean([trainer.psnr_db(index) for index in range(len(views.fine))])), 3),
        },
    )
    checkpoint.unlink(missing_ok=True)
