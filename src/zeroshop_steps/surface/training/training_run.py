"""A training from the command line: read the inputs, resume or begin, train, write the model and the record."""

import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere, fit_object_sphere
from zeroshop_steps.geometry.cameras.sparse_files import read_reconstruction
from zeroshop_steps.runtime.cache import content_digest
from zeroshop_steps.runtime.code_version import code_version
from zeroshop_steps.runtime.compute.threads import use_threads
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_write, write_json
from zeroshop_steps.surface.mvs.seeds import Seeds, carve_hull, read_seeds
from zeroshop_steps.surface.rendering.training_views import (
    CameraSet,
    TrainingView,
    make_grid_view,
    make_seed_views,
    make_training_views,
    read_camera_set,
)
from zeroshop_steps.surface.training.initialization import Initialization, make_initialization
from zeroshop_steps.surface.training.trainer import ModelT, RenderingT, SettingsT, Trainer, ViewPyramid

CHECKPOINT = "checkpoint.pt"
"""The unfinished run, beside the files that it will write."""
PRIMITIVES_MIN = 10
"""Fewer surfels or voxels than this are no object: masks and cameras do not agree."""


@dataclass(frozen=True)
class TrainingInputs:
    """What an optimizer trains on.

    Attributes:
        seed_views: the views that stereo uses; its depth maps have their names and sizes.
        identity: says which images, cameras and seeds these are, for checkpoints.
    """

    camera_set: CameraSet
    sphere: ObjectSphere
    views: ViewPyramid
    seed_views: list[TrainingView]
    seeds: Seeds
    identity: dict[str, Any]

    @staticmethod
    def read(args: Namespace, step: str) -> "TrainingInputs":
        """From the options of `training_options.add_training_arguments`, for a step of this package, e.g. "surface.twodgs"."""
        camera_set = read_camera_set(args.cameras)
        sphere = fit_object_sphere(camera_set.model.cameras, camera_set.masks)
        views = ViewPyramid(
            make_training_views(camera_set, sphere, args.image_width_px // 2, border_px=6),
            make_training_views(camera_set, sphere, args.image_width_px, border_px=8),
        )
        stereo_views = make_seed_views(camera_set, sphere)
        if args.initialization == "sparse":
            seeds = make_sparse_seeds(args.cameras, sphere, stereo_views)
        elif args.stereo:
            seeds = read_seeds(args.stereo, sphere, [view.camera for view in stereo_views])
        else:
            raise StepError("training starts from stereo, but no seeds.npz is given: add --stereo, or --initialization sparse")
        # A checkpoint belongs to its images, cameras, seeds and code as much as to its settings.
        poses = [view.camera.camera_from_world.ravel().tolist() for view in views.fine]
        identity = {
            "image_width_px": args.image_width_px,
            "cameras": poses,
            "stereo": content_digest(args.stereo) if args.stereo else None,
            "code": code_version(step),
        }
        return TrainingInputs(camera_set, sphere, views, stereo_views, seeds, identity)


def train_model(
    args: Namespace,
    step: str,
    method: str,
    trainer_class: type[Trainer[ModelT, RenderingT, SettingsT]],
    settings: SettingsT,
    hull_points: int,
    initialize: Callable[[Initialization, TrainingInputs], ModelT],
    write: Callable[[ModelT, ObjectSphere], None],
) -> None:
    """Train a model from the command line's inputs and write it, training.csv and training.json.

    Args:
        args: the options of `training_options.add_training_arguments`.
        step: the step of this package, e.g. "surface.twodgs"; a change of its code makes checkpoints invalid.
        method: the optimizer's name in training.json.
        hull_points: how many points of the carved hull the initialization takes, at most; none with --initialization sparse.
        initialize: makes the model to start from.
        write: writes the trained model.

    Raises:
        StepError: an input is missing or damaged, training diverged, or next to nothing is left of the model.
    """
    threads = use_threads(args.threads)
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    inputs = TrainingInputs.read(args, step)
    model, hull_points = inputs.camera_set.model, hull_points if args.initialization == "stereo" else 0
    initialization = make_initialization(model, inputs.sphere, inputs.seed_views, inputs.seeds, hull_points, args.seed)
    checkpoint = args.out / CHECKPOINT
    trainer = None
    if args.resume and checkpoint.exists():
        trainer = trainer_class.resume(checkpoint, inputs.views, initialization, settings, inputs.identity)
    resumed_from = trainer.iteration if trainer else 0
    if trainer is None:
        trainer = trainer_class(initialize(initialization, inputs), inputs.views, initialization, settings)
    trainer.run_with_checkpoints(args.checkpoint_every, checkpoint, inputs.identity, args.cameras)
    if len(trainer.model) < PRIMITIVES_MIN:
        left = f"{len(trainer.model)} {trainer.primitives}"
        raise StepError(f"training on {args.cameras} left {left}: masks and cameras do not agree; look at both")
    write(trainer.model, inputs.sphere)
    seconds = time.monotonic() - start_s, time.process_time() - start_cpu_s
    write_training_record(args, trainer, method, threads, resumed_from, seconds)


def write_loss_curve(path: Path, history: list[dict[str, float]]) -> None:
    """Write the loss by term as CSV, one row an entry; a term that an entry lacks stays empty."""
    rows = [{key: f"{value:.6g}" for key, value in row.items()} for row in history]
    with atomic_write(path) as temporary:
        pd.DataFrame(rows).to_csv(temporary, index=False, lineterminator="\n")


def write_training_record(
    args: Namespace,
    trainer: Trainer[ModelT, RenderingT, SettingsT],
    method: str,
    threads: int,
    resumed_from: int,
    seconds: tuple[float, float],
) -> None:
    """Write training.csv and training.json into --out and delete the checkpoint, which is no longer needed.

    Args:
        resumed_from: iteration of the checkpoint that the run continued, 0 for none.
        seconds: of wall time and of CPU time.
    """
    write_loss_curve(args.out / "training.csv", trainer.history)
    write_json(
        args.out / "training.json",
        {
            "method": method,
            "seconds": round(seconds[0], 2),
            "cpu_seconds": round(seconds[1], 2),
            "resumed_from_iteration": resumed_from,
            "threads": threads,
            "image_width_px": args.image_width_px,
            "settings": vars(trainer.settings),
            trainer.count_name: len(trainer.model),
            "psnr_training_db": round(float(np.mean([trainer.psnr_db(index) for index in range(len(trainer.pyramid.fine))])), 3),
        },
    )
    (args.out / CHECKPOINT).unlink(missing_ok=True)


def make_sparse_seeds(cameras: Path, sphere: ObjectSphere, views: list[TrainingView]) -> Seeds:
    """What stereo would leave if it found nothing, with the depths of the sparse points in the masks of the images that see them.

    Args:
        cameras: folder of the registration.
        sphere: the object's, which normalizes points.
        views: those that stereo would use.

    Returns:
        No seed; a hull that only the masks carve.
    """
    grid = [make_grid_view(view) for view in views]
    reconstruction = read_reconstruction(cameras / "sparse")
    seen = {image.name: image for image in reconstruction.images.values()}
    depth_maps = {}
    for view in grid:
        depth: np.ndarray = np.zeros((view.camera.height_px, view.camera.width_px), np.float32)
        ids = [point.point3D_id for point in seen[view.camera.name].points2D if point.has_point3D()]
        points = np.array([reconstruction.points3D[index].xyz for index in ids]).reshape(-1, 3)
        rows, columns, z, inside = view.camera.find_pixels((points - sphere.centre) / sphere.radius)
        inside[inside] = view.mask.numpy()[rows[inside], columns[inside]] > 0.5
        depth[rows[inside], columns[inside]] = z[inside]
        depth_maps[view.camera.name] = depth
    nothing = np.zeros((0, 3))
    return Seeds(nothing, nothing, nothing, depth_maps, carve_hull(grid))
