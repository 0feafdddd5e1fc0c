"""What pose estimators share: the choice of detections, the loop over the images, and the result file."""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import Detection, decode_mask, encode_mask, read_detections
from zeroshop_steps.bop.formats.estimates import Estimates, write_estimates
from zeroshop_steps.bop.formats.models import ObjectModel, list_objects, read_models
from zeroshop_steps.bop.formats.targets import Frames, Target, read_target_frames, read_targets, size_finder
from zeroshop_steps.detect.detector_io import identify, read_depth, read_photo
from zeroshop_steps.detect.joined import join_touching
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.partial_results import PartialResults
from zeroshop_steps.runtime.progress import track

NEAR_DIAMETERS = 0.6  # from the middle of what was measured of an object; a point farther away cannot be on it
SPARE_DETECTIONS = 2  # of a target, beyond its number of instances: the scores of their poses decide which detections were right

Estimator = Callable[[Detection, np.ndarray, np.ndarray, np.ndarray, Frame], tuple[np.ndarray, float] | None]
"""Takes a detection, its (height, width) bool mask, the photo, the measured depth in mm and the frame. Returns (4, 4)
camera_from_model in mm and a score, or None if the pose cannot be estimated."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that all estimators have."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout, true or reconstructed")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json")
    parser.add_argument("--detections", type=Path, help="BOP COCO result file with masks (default: the true visible masks)")
    parser.add_argument("--out", type=Path, required=True, help="BOP result CSV to write")


def run_estimator(
    args: argparse.Namespace,
    prepare: Callable[[dict[int, ObjectModel]], Estimator],
    spare: int = SPARE_DETECTIONS,
    sure: float | None = None,
) -> None:
    """Estimate the poses of the targets' detections and write them.

    Args:
        args: the command line.
        prepare: makes an estimator for these models.
        spare: detections of a target that are tried beyond its number of instances; of use where poses are scored.
        sure: score of a pose; where an object has no better one in an image, its detections that touch are tried as one, too.
    """
    targets = read_targets(args.targets)
    frames = read_target_frames(args.scenes, targets, args.targets, truth_needed=args.detections is None)
    known = list_objects(args.models)
    lacking = sorted({target.obj_id for target in targets} - set(known))
    if len(lacking) == len({target.obj_id for target in targets}):
        raise StepError(f"{args.targets} asks for the objects {lacking}, of which {args.models} has none; it has {known}")
    if lacking:
        warn(f"{args.models} has no model of the objects {lacking}; their poses are not estimated")
    found = read_detections(args.detections, size_finder(frames)) if args.detections else read_true_masks(frames)
    found = choose_detections(found, targets, known, spare if args.detections else 0, args.detections)
    estimator = prepare(read_models(args.models, {one.object_id for one in found}))
    with PartialResults(args.out, identify(args)) as kept:
        write_estimates(args.out, estimate_all(found, frames, estimator, sure if args.detections else None, kept))


def read_true_masks(frames: Frames) -> list[Detection]:
    """The true visible masks as detections with score 1.

    Raises:
        StepError: the masks are missing.
    """
    found = []
    for frame in frames.values():
        for index, instance in enumerate(frame.instances):
            mask = frame.mask(index)
            if mask.any():
                found.append(Detection(frame.scene_id, frame.image_id, instance.object_id, 1.0, None, encode_mask(mask)))
    return found


def choose_detections(
    found: Sequence[Detection], targets: Sequence[Target], known: Sequence[int], spare: int, path: Path | None
) -> list[Detection]:
    """The most confident detections of each target whose object has a model: one per instance and `spare` more.

    Args:
        found: all detections.
        targets: what to estimate.
        known: objects that have models.
        spare: how many more to try.
        path: of the detections, for messages; None for true masks, which are all taken.

    Raises:
        StepError: one has no mask.
    """
    by_key: dict[tuple[int, int, int], list[Detection]] = {}
    for one in found:
        by_key.setdefault((one.scene_id, one.image_id, one.object_id), []).append(one)
    chosen = []
    for target in (target for target in targets if target.obj_id in known):
        here = sorted(by_key.get((target.scene_id, target.im_id, target.obj_id), []), key=lambda one: -one.score)
        chosen += here[: target.inst_count + spare] if path else here
    for one in chosen:
        if one.mask is None:
            raise StepError(f"{path}: a detection of object {one.object_id} has no segmentation; poses need masks")
    return chosen


def estimate_all(
    detections: Sequence[Detection],
    frames: Frames,
    estimator: Estimator,
    sure: float | None = None,
    kept: PartialResults | None = None,
) -> Estimates:
    """Estimate the poses of the detections, image by image. Their time is that of the whole image, with that of detection if known.

    `sure` is as in `run_estimator`; images in `kept` are not looked at again, and the others are added to it.
    """
    by_image: dict[tuple[int, int], dict[int, list[Detection]]] = {}
    for one in detections:
        by_image.setdefault((one.scene_id, one.image_id), {}).setdefault(one.object_id, []).append(one)
    rows: list[tuple] = []
    for image, objects in track(by_image.items(), "poses", len(by_image)):
        key = "/".join(map(str, image))
        if kept and key in kept.done:
            rows += [(*row[:4], np.array(row[4]), row[5]) for row in kept.done[key]]
            continue
        start_s, here = time.monotonic(), []
        photo = read_photo(frames[image])
        depth = read_depth(frames[image], photo, "and poses are estimated from depth: add it")
        for members in objects.values():
            masks = [_read_mask(one, frames[image], depth) for one in members]
            found = [estimator(one, mask, photo, depth, frames[image]) for one, mask in zip(members, masks, strict=True)]
            if sure is not None and max((one[1] for one in found if one), default=0.0) < sure:
                found += [estimator(members[0], mask, photo, depth, frames[image]) for mask in join_touching(masks)]
            here += [(*image, members[0].object_id, one[1], one[0]) for one in found if one]
        seconds = time.monotonic() - start_s + max(next(iter(objects.values()))[0].seconds, 0.0)
        new = [(*row, seconds) for row in here]
        rows += new
        if kept:
            kept.keep(key, [(*row[:3], float(row[3]), np.asarray(row[4], float).tolist(), row[5]) for row in new])
    poses = np.array([row[4] for row in rows]).reshape(-1, 4, 4)
    numbers = np.array([row[:3] for row in rows], np.int64).reshape(-1, 3)
    scores, times = (np.array([row[column] for row in rows], float) for column in (3, 5))
    scene_ids, image_ids, object_ids = numbers.T
    return Estimates(scene_ids, image_ids, object_ids, scores, poses[:, :3, :3], poses[:, :3, 3], times)


def _read_mask(detection: Detection, frame: Frame, depth: np.ndarray) -> np.ndarray:
    mask = decode_mask(detection.require_mask())
    if mask.shape != depth.shape:
        raise StepError(
            f"a mask of object {detection.object_id} in {frame.name} is {mask.shape[1]} x {mask.shape[0]} px, the image"
            f" {depth.shape[1]} x {depth.shape[0]} px; detect in images of the same size"
        )
    return mask
