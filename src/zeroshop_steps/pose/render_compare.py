"""Estimate poses without any network: many rotations, shape first, then rendered views against depth, silhouette and colour.

Of every detection with an object and a mask: hypotheses from 42 sides and twelve turns are iterated onto the measured
points, the best are compared with the image, and the winner is refined. Writes BOP's result CSV; the score of an estimate is
how well it explains the image times the score of its detection.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop.detections import Detection, decode_mask, encode_mask, read_detections
from zeroshop_steps.bop.estimates import Estimates, write_estimates
from zeroshop_steps.bop.models import Model, listed_objects, read_models
from zeroshop_steps.bop.scene import Frame
from zeroshop_steps.bop.targets import Frames, read_target_frames, read_targets
from zeroshop_steps.errors import StepError
from zeroshop_steps.images import read_image
from zeroshop_steps.pose.compare import Comparison, Patch, patch_of
from zeroshop_steps.pose.hypotheses import PoseSearch
from zeroshop_steps.progress import track

LEAST_POINTS = 30
NUDGES_DEG = (6.0, 3.0, 1.5)
FIRST_REFINED = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout, true or reconstructed")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--targets", type=Path, required=True, help="test_targets_bop19.json")
    parser.add_argument("--detections", type=Path, help="BOP COCO result file with masks (default: the true visible masks)")
    parser.add_argument("--out", type=Path, required=True, help="BOP result CSV to write")


def run(args: argparse.Namespace) -> None:
    """Estimate the poses of all detections in the target images."""
    targets = read_targets(args.targets)
    frames = read_target_frames(args.scenes, targets, args.targets)
    wanted = {(target.scene_id, target.im_id, target.obj_id) for target in targets}
    found = read_detections(args.detections) if args.detections else true_masks(frames)
    known = set(listed_objects(args.models))
    found = [one for one in found if (one.scene_id, one.image_id, one.object_id) in wanted and one.object_id in known]
    for one in found:
        if one.mask is None:
            raise StepError(f"{args.detections}: a detection of object {one.object_id} has no segmentation; poses need masks")
    write_estimates(args.out, estimate_all(found, frames, read_models(args.models, {one.object_id for one in found})))


def true_masks(frames: Frames) -> list[Detection]:
    """Perfect detections of everything visible."""
    found = []
    for frame in frames.values():
        for index, instance in enumerate(frame.instances):
            mask = frame.mask(index)
            if mask.any():
                found.append(Detection(frame.scene_id, frame.image_id, instance.object_id, 1.0, None, encode_mask(mask)))
    return found


def estimate_all(detections: Sequence[Detection], frames: Frames, models: dict[int, Model]) -> Estimates:
    """Estimates of the detections, image by image; those with hardly any measured point have none."""
    searches = {number: PoseSearch(model.mesh, model.diameter_mm) for number, model in models.items()}
    comparisons = {number: Comparison(model.mesh) for number, model in models.items()}
    by_image: dict[tuple[int, int], list[Detection]] = {}
    for detection in detections:
        by_image.setdefault((detection.scene_id, detection.image_id), []).append(detection)
    rows: list[tuple] = []
    for image, members in track(by_image.items(), "poses", len(by_image)):
        start_s, here = time.monotonic(), []
        frame = frames[image]
        photo, depth = read_image(frame.picture("rgb")), frame.depth_mm()
        for detection in members:
            number = detection.object_id
            best = estimate(decode_mask(detection.mask), photo, depth, frame, searches[number], comparisons[number], models[number])
            if best is not None:
                here.append((*image, number, best[1] * detection.score, best[0]))
        seconds = time.monotonic() - start_s + max(members[0].seconds, 0.0)
        rows += [(*row, seconds) for row in here]
    poses = np.array([row[4] for row in rows]).reshape(-1, 4, 4)
    numbers = np.array([row[:3] for row in rows], np.int64).reshape(-1, 3)
    scores, seconds = (np.array([row[column] for row in rows], float) for column in (3, 5))
    return Estimates(*numbers.T, scores, poses[:, :3, :3], poses[:, :3, 3], seconds)


def estimate(
    mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, frame: Frame, search: PoseSearch, comparison: Comparison, model: Model
) -> tuple[np.ndarray, float] | None:  # fmt: skip
    """(camera_from_model (4, 4) mm, score 0..1) of one detection; None where too little of it was measured."""
    points = measured_points(mask, depth_mm, frame.intrinsics, model.diameter_mm)
    if len(points) < LEAST_POINTS:
        return None
    poses = search.search(points, depth_mm, mask, frame.intrinsics)
    patch = patch_of(photo, depth_mm, mask, frame.intrinsics)
    scores = np.array([comparison.score(pose, patch) for pose in poses])
    tried = []
    for index in np.argsort(-scores, kind="stable")[:FIRST_REFINED]:
        tried.append(nudged(poses[index], float(scores[index]), patch, comparison, model))
    pose, score = max(tried, key=lambda one: one[1])
    final = search.refined(pose, points)
    again = comparison.score(final, patch)
    return (final, again) if again >= score else (pose, score)


def measured_points(mask: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, diameter_mm: float) -> np.ndarray:
    """(N, 3) measured points of a mask in random order, without those too far off to be the object's."""
    rows, columns = np.nonzero(mask & (depth_mm > 0))
    depths = depth_mm[rows, columns].astype(float)
    near = np.abs(depths - np.median(depths)) < 0.6 * diameter_mm if len(depths) else np.zeros(0, bool)
    pixels = np.stack([columns, rows, np.ones_like(rows)], 1)[near]
    points = pixels @ np.linalg.inv(intrinsics).T * depths[near][:, None]
    return points[np.random.default_rng(0).permutation(len(points))]


def nudged(pose: np.ndarray, score: float, patch: Patch, comparison: Comparison, model: Model) -> tuple[np.ndarray, float]:
    """The pose turned about the model's middle in ever smaller steps, as long as the image is explained better."""
    middle = (model.mesh.vertices.min(0) + model.mesh.vertices.max(0)) / 2
    for angle in NUDGES_DEG:
        for axis in np.eye(3):
            for sign in (1, -1):
                turn = np.eye(4)
                turn[:3, :3] = Rotation.from_rotvec(sign * np.radians(angle) * axis).as_matrix()
                turn[:3, 3] = middle - turn[:3, :3] @ middle
                other = comparison.score(pose @ turn, patch)
                if other > score:
                    pose, score = pose @ turn, other
    return pose, score
