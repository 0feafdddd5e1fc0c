"""What detectors share: the images, the loop over them, non-maximum suppression and the result file."""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps import __version__
from zeroshop_steps.bop.formats.bop_scenes import Frame, check_depth, list_scenes, read_scene
from zeroshop_steps.bop.formats.detections import Detection, encode_mask, mask_to_box, write_detections
from zeroshop_steps.bop.formats.models import ObjectModel, list_objects, read_models
from zeroshop_steps.bop.formats.targets import read_target_frames, read_targets
from zeroshop_steps.detect.templates import Templates, read_templates
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.runtime.errors import StepError, warn
from zeroshop_steps.runtime.partial_results import PartialResults
from zeroshop_steps.runtime.progress import track

LEAST_CONFIDENCE = 0.01  # less likely detections are not written
MOST_IOU = 0.25  # of two detections of one object; with more, the less confident one is dropped
CENTRAL = (0.2, 0.8)  # shares of the image between which the principal point must lie; outside, K belongs to another image size


@dataclass(frozen=True)
class ObjectMask:
    """One detected object: its number, a confidence, and its (height, width) bool mask, which is not empty."""

    object_id: int
    score: float
    mask: np.ndarray


ViewsOf = Callable[[int], Templates]
"""Gives the views of a model by its number."""
Detector = Callable[[Frame], Sequence[ObjectMask]]
"""Detects the models that it was prepared for in one image."""


def add_image_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that all detectors have."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout, true or reconstructed")
    parser.add_argument("--templates", type=Path, required=True, help="their views, written by --method templates")
    parser.add_argument("--scenes", type=Path, required=True, help="the split's folder, which holds 000001 and so on")
    parser.add_argument("--targets", type=Path, help="test_targets_bop19.json; only its images are used (default: every image)")
    parser.add_argument("--out", type=Path, required=True, help="BOP COCO result file to write")


def read_frames(scenes: Path, targets: Path | None) -> list[Frame]:
    """The images that targets name, or all images; which objects the targets name is ignored."""
    if targets is not None:
        return list(read_target_frames(scenes, read_targets(targets), targets, truth_needed=False).values())
    return [frame for folder in list_scenes(scenes).values() for frame in read_scene(folder, truth_needed=False).values()]


def read_photo(frame: Frame) -> np.ndarray:
    """The (height, width, 3) uint8 colour image of a frame.

    Raises:
        StepError: it is missing, or the camera belongs to an image of another size.
    """
    photo = frame.color()
    if photo is None:
        raise StepError(f"{frame.folder / 'rgb'} has no image {frame.image_id:06d} ({frame.name}); detectors need colour images: add it")
    height, width = photo.shape[:2]
    middle = frame.intrinsics[:2, 2]
    size = np.array([width, height])
    if not ((size * CENTRAL[0] < middle) & (middle < size * CENTRAL[1])).all():
        path = frame.image_path("rgb") or "the colour image"
        raise StepError(
            f"{path} is {width} x {height} px, but cam_K of {frame.name} has its middle at ({middle[0]:.0f}, {middle[1]:.0f}):"
            " camera and image are of different sizes; scale cam_K with the image"
        )
    return photo


def read_depth(frame: Frame, photo: np.ndarray, remedy: str) -> np.ndarray:
    """The (height, width) float32 depth of a frame in mm, 0 where there is none.

    Raises:
        StepError: it is missing, with what to do then (`remedy`), has another size than the photo, or is in metres.
    """
    if not frame.has_depth:
        raise StepError(f"{frame.folder / 'depth'} has no image {frame.image_id:06d} ({frame.name}), {remedy}")
    depth_mm = frame.depth_mm()
    check_depth(depth_mm, frame, (photo.shape[1], photo.shape[0]))
    return depth_mm


def warn_of_plain_models(models: Mapping[int, ObjectModel]) -> None:
    """Warn of models without any colour, whose views are plain grey."""
    plain = [number for number, model in models.items() if not model.mesh.is_colored]
    if plain:
        warn(f"the models of the objects {plain} have no texture or colours; networks see them in grey, and cannot tell alike ones apart")


def detect_in_files(args: argparse.Namespace, prepare: Callable[[argparse.Namespace, dict[int, ObjectModel], ViewsOf], Detector]) -> None:
    """Detect the models of a folder in the images of a split, as the arguments say.

    Args:
        args: those of `add_image_arguments`, and the method's own.
        prepare: the method's function of this name, which the servers of a robot call, too: the detector for these models.
    """
    frames = read_frames(args.scenes, args.targets)
    models = read_models(args.models, list_objects(args.models))
    detect = prepare(args, models, lambda number: read_templates(args.templates, number))
    with PartialResults(args.out, identify(args)) as kept:
        run_detector(args.out, frames, detect, kept)


def identify(args: argparse.Namespace) -> dict[str, Any]:
    """What results image by image belong to: the code's version, the options, the files that they name, and the weights that are there."""
    given = {key: value for key, value in vars(args).items() if key not in ("out", "threads", "scenes")}
    return {**given, "scenes": str(args.scenes), "version": __version__, "of networks": WEIGHTS_FOLDER}


def run_detector(
    path: Path, frames: Sequence[Frame], detect: Callable[[Frame], Sequence[ObjectMask]], kept: PartialResults | None = None
) -> None:
    """Detect in every image that is not in `kept`, and write the detections with the seconds that each image took."""
    detections: list[Detection] = []
    for frame in track(frames, "detections", len(frames)):
        key = f"{frame.scene_id}/{frame.image_id}"
        if kept and key in kept.done:
            detections += [_from_json(frame, row) for row in kept.done[key]]
            continue
        start_s = time.monotonic()
        # COCO's evaluation ignores further ones.
        found = sorted(detect(frame), key=lambda one: -one.score)[:100]
        seconds = time.monotonic() - start_s
        here = [
            Detection(frame.scene_id, frame.image_id, one.object_id, one.score, mask_to_box(one.mask), encode_mask(one.mask), seconds)
            for one in found
        ]
        detections += here
        if kept:
            kept.keep(key, [_as_json(one) for one in here])
    write_detections(path, detections)
    print(f"{path}: {len(detections)} detections in {len(frames)} images")


def _as_json(one: Detection) -> list[Any]:
    mask = one.require_mask()
    return [one.object_id, float(one.score), one.box_px, mask["size"], mask["counts"].decode("ascii"), one.seconds]


def _from_json(frame: Frame, row: list[Any]) -> Detection:
    object_id, score, box, size, counts, seconds = row
    mask = {"size": size, "counts": counts.encode("ascii")}
    return Detection(frame.scene_id, frame.image_id, object_id, score, tuple(box), mask, seconds)


def suppress_masks(masks: Sequence[np.ndarray], scores: np.ndarray, most_iou: float) -> list[int]:
    """Non-maximum suppression: indices of the masks, the most confident first, that overlap no more confident one by over `most_iou`."""
    flat = np.stack([mask.ravel() for mask in masks]).astype(np.float32) if len(masks) else np.zeros((0, 1), np.float32)
    areas = flat.sum(1)
    return _suppress(lambda one, others: _iou(flat[others] @ flat[one], areas[one], areas[others]), scores, most_iou)


def suppress_boxes(boxes_px: np.ndarray, scores: np.ndarray, most_iou: float) -> list[int]:
    """Non-maximum suppression of (N, 4) boxes (x, y, width, height); see `suppress_masks`."""
    low, high = boxes_px[:, :2], boxes_px[:, :2] + boxes_px[:, 2:]
    areas = boxes_px[:, 2:].prod(1)

    def overlap(one: int, others: list[int]) -> np.ndarray:
        sides = np.minimum(high[one], high[others]) - np.maximum(low[one], low[others])
        return _iou(np.clip(sides, 0, None).prod(1), areas[one], areas[others])

    return _suppress(overlap, scores, most_iou)


def _suppress(overlap: Callable[[int, list[int]], np.ndarray], scores: np.ndarray, most_iou: float) -> list[int]:
    kept: list[int] = []
    for index in np.argsort(-np.asarray(scores), kind="stable").tolist():
        if not kept or overlap(index, kept).max() <= most_iou:
            kept.append(index)
    return kept


def _iou(common: np.ndarray, area: float, areas: np.ndarray) -> np.ndarray:
    return common / np.maximum(area + areas - common, 1e-9)
