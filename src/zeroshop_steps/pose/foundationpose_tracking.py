"""Follow objects through an RGB-D film with FoundationPose: the pose in a frame, refined once, is the start in the next one.

A film is a scene in BOP's layout whose images follow each other. Each object that the targets name in the first image of a scene is
found there as by `foundationpose`, from its true visible mask or from that of a detector, and then followed through all images.
Needs the weights of `foundationpose`. Writes BOP's result CSV, with a pose of each object in each image.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from zeroshop_steps.bop.formats.bop_scenes import Frame, list_scenes, read_scene
from zeroshop_steps.bop.formats.detections import decode_mask, read_detections
from zeroshop_steps.bop.formats.estimates import Estimates, write_estimates
from zeroshop_steps.bop.formats.models import list_objects, read_models
from zeroshop_steps.bop.formats.targets import Frames, Target, read_targets, size_finder
from zeroshop_steps.detect.detector_io import read_depth, read_photo
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.networks.devices import choose_device, run_network
from zeroshop_steps.networks.foundationpose.model import SIZES
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, resolve_weights
from zeroshop_steps.pose import dataset
from zeroshop_steps.pose.foundationpose import WEIGHTS
from zeroshop_steps.pose.foundationpose.estimator import FoundationPoseModel, PoseEstimator
from zeroshop_steps.pose.foundationpose.networks import TorchNetworks
from zeroshop_steps.pose.foundationpose.steps import add_common_arguments, prepare_models
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.progress import track


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Follow the objects and write their poses."""
    device = torch.device(choose_device(args.device))
    networks = TorchNetworks([resolve_weights(WEIGHTS_FOLDER / name, name, SIZES) for name in WEIGHTS], device)
    estimator = PoseEstimator(networks, device, args.iterations, MM_PER_M * args.depth_cut_m)
    films = read_films(args.scenes, read_targets(args.targets), args.targets, truth_needed=args.detections is None)
    known = set(list_objects(args.models))
    models = read_models(args.models, {target.obj_id for film in films for target in film.targets} & known)
    ready = prepare_models(models, device)
    rows = [row for film in films for row in follow(film, find_starts(film, args.detections, sorted(known)), estimator, ready)]
    write_estimates(args.out, _collect(rows))


@dataclass(frozen=True)
class Film:
    """The images of a scene in the order of their numbers, and the targets in the first of them."""

    frames: list[Frame]
    targets: list[Target]


Row = tuple[Frame, int, float, np.ndarray, float]
"""A frame, the object, the score of its detection, its (4, 4) camera_from_model in mm, and the seconds of the frame."""


def read_films(scenes: Path, targets: list[Target], path: Path, truth_needed: bool) -> list[Film]:
    """The films in which targets are; only those of each film's first image count.

    Raises:
        StepError: the targets (in `path`) name a scene that is not there, or nothing in the first image of a scene.
    """
    folders, films = list_scenes(scenes), []
    for number in dict.fromkeys(target.scene_id for target in targets):
        if number not in folders:
            raise StepError(f"{path} asks for scene {number}, which {scenes} does not have; it has {sorted(folders)}")
        frames = [frame for _, frame in sorted(read_scene(folders[number], truth_needed).items())]
        first = [target for target in targets if (target.scene_id, target.im_id) == (number, frames[0].image_id)]
        if not first:
            raise StepError(f"{path} asks for nothing in {frames[0].name}, where following begins; add the objects to follow")
        films.append(Film(frames, first))
    return films


def find_starts(film: Film, detections: Path | None, known: list[int]) -> list[tuple[int, float, np.ndarray]]:
    """The object, its score and its (H, W) mask for each object to follow, in the film's first image."""
    start: Frames = {(film.frames[0].scene_id, film.frames[0].image_id): film.frames[0]}
    found = read_detections(detections, size_finder(start)) if detections else dataset.read_true_masks(start)
    chosen = dataset.choose_detections(found, film.targets, known, 0, detections)
    return [(one.object_id, one.score, decode_mask(one.require_mask())) for one in chosen]


def follow(
    film: Film, starts: list[tuple[int, float, np.ndarray]], estimator: PoseEstimator, ready: dict[int, FoundationPoseModel]
) -> list[Row]:
    """The poses in every frame; an object of which too little was measured in the first one is left out."""
    poses: dict[int, np.ndarray] = {}
    rows: list[Row] = []
    for place, frame in enumerate(track(film.frames, "frames", len(film.frames))):
        began_s = time.monotonic()
        photo = read_photo(frame)
        seen = photo, read_depth(frame, photo, "and poses are estimated from depth: add it"), frame.intrinsics
        for index, (number, _, mask) in enumerate(starts):
            with run_network(estimator.device, "FoundationPose"):
                if place == 0:
                    if mask.shape != seen[1].shape:
                        raise StepError(
                            f"a mask of object {number} in {frame.name} has another size than the image; detect in these images"
                        )
                    pose = estimator.register(mask, *seen, ready[number])
                else:
                    pose = estimator.track(poses[index], *seen, ready[number]) if index in poses else None
            if pose is not None:
                poses[index] = pose
        seconds = time.monotonic() - began_s
        rows += [(frame, starts[index][0], starts[index][1], pose, seconds) for index, pose in poses.items()]
    return rows


def _collect(rows: list[Row]) -> Estimates:
    """The rows as BOP's results."""
    poses = np.array([row[3] for row in rows]).reshape(-1, 4, 4)
    numbers = np.array([(row[0].scene_id, row[0].image_id, row[1]) for row in rows], np.int64).reshape(-1, 3)
    scores, seconds = (np.array([row[column] for row in rows], float) for column in (2, 4))
    scene_ids, image_ids, object_ids = numbers.T
    return Estimates(scene_ids, image_ids, object_ids, scores, poses[:, :3, :3], poses[:, :3, 3], seconds)
