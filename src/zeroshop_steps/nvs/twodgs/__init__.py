"""2D Gaussian Splatting (Huang et al. 2024): train planar disks on the masked, registered images of an object.

Writes splats.ply (opened by common splat viewers), training.csv (the loss by term) and training.json (settings,
figures). While it trains, checkpoint.pt is kept beside them; --resume goes on from there.
"""

import argparse
import csv
import dataclasses
import os
import time
from pathlib import Path

import numpy as np

from zeroshop_steps.cache import Cached

SEED_WIDTH_PX = 1000
"""Width of the images on which the starting points are found."""
HULL_POINTS = 4000
CACHED = Cached(
    inputs=("cameras/images", "cameras/masks", "cameras/sparse"),
    ignored=("threads", "resume", "checkpoint_every"),
    outputs=("training.csv", "training.json", "splats.ply"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--cameras", type=Path, required=True, help="registration: images, masks and sparse model")
    parser.add_argument("--out", type=Path, required=True, help="folder for splats.ply, training.csv and training.json")
    parser.add_argument("--iterations", type=int, default=800)
    parser.add_argument("--image-width-px", type=int, default=800, help="images are resampled to this width, never up")
    parser.add_argument("--sh-degree", type=int, default=2, choices=range(4), help="spherical-harmonics degree of the colour")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--checkpoint-every", type=int, default=1000, help="iterations between checkpoints")
    parser.add_argument("--resume", action="store_true", help="go on from a checkpoint of the same settings")


def run(args: argparse.Namespace) -> None:
    import numba
    import torch

    from zeroshop_steps.errors import StepError
    from zeroshop_steps.files import write_json, written_whole
    from zeroshop_steps.nvs.twodgs.start import find_start
    from zeroshop_steps.nvs.twodgs.surfels import start_surfels, write_splat_ply
    from zeroshop_steps.nvs.twodgs.train import Trainer, TrainingSettings, Views
    from zeroshop_steps.nvs.views import object_sphere, read_camera_set, training_views

    threads = max(1, min(args.threads, os.cpu_count() or 1))
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    # The losses' small images gain nothing from a second thread, and a fixed number keeps sums in one order.
    torch.set_num_threads(1)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    camera_set = read_camera_set(args.cameras)
    sphere = object_sphere(camera_set.model.cameras, camera_set.masks)
    views = Views(
        training_views(camera_set, sphere, args.image_width_px // 2, border_px=6),
        training_views(camera_set, sphere, args.image_width_px, border_px=8),
    )
    settings = TrainingSettings(iterations=args.iterations, sh_degree=args.sh_degree, seed=args.seed)
    checkpoint = args.out / "checkpoint.pt"
    # A checkpoint belongs to its images and cameras as much as to its settings.
    identity = {"image_width_px": args.image_width_px, "cameras": [view.camera.camera_from_world.ravel().tolist() for view in views.fine]}
    start = find_start(camera_set.model, sphere, training_views(camera_set, sphere, SEED_WIDTH_PX, border_px=10), HULL_POINTS, args.seed)
    trainer = Trainer.resume(checkpoint, views, start, settings, identity) if args.resume and checkpoint.exists() else None
    resumed_from = trainer.iteration if trainer else 0
    if trainer is None:
        trainer = Trainer(start_surfels(start.points, start.colors, start.normals, args.seed), views, start, settings)
    while trainer.iteration < settings.iterations:
        trainer.run(min(trainer.iteration + args.checkpoint_every, settings.iterations))
        if trainer.iteration < settings.iterations:
            trainer.save(checkpoint, identity)
    if not all(torch.isfinite(tensor).all() for tensor in trainer.surfels.tensors().values()):
        raise StepError(f"training on {args.cameras} diverged (parameters that are not finite); lower --sh-degree or check the cameras")
    if len(trainer.surfels) < 10:
        raise StepError(f"training on {args.cameras} left {len(trainer.surfels)} disks: masks and cameras do not agree; look at both")

    write_splat_ply(args.out / "splats.ply", trainer.surfels, sphere)
    with written_whole(args.out / "training.csv") as temporary, open(temporary, "w", newline="") as file:
        names = list(dict.fromkeys(name for row in trainer.history for name in row))
        writer = csv.DictWriter(file, names, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: f"{value:.6g}" for key, value in row.items()} for row in trainer.history)
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
