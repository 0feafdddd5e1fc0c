"""The instance segmentation of SAM-6D (Lin et al., SAM-6D: Segment Anything Model Meets Zero-Shot 6D Object Pose Estimation, CVPR 2024).

Regions are proposed and named as by `cnos`. To the mean cosine of DINOv2's class tokens come two scores of the most similar view:
how well the region's patches agree with those of the view, and how well its box agrees with that of the model, turned as in the view
and put where the region's depth is. Needs RGB-D images and the weights of `cnos`; `contour` needs no weights. Writes BOP's COCO JSON.
"""

import argparse
from dataclasses import dataclass

import numpy as np
import torch

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import mask_to_box
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.detect.cnos import score_objects
from zeroshop_steps.detect.cnos.crops import CropDescriber
from zeroshop_steps.detect.detector_io import (
    MOST_IOU,
    Detector,
    ObjectMask,
    ViewsOf,
    add_image_arguments,
    detect_in_files,
    read_depth,
    read_photo,
    suppress_boxes,
    warn_of_plain_models,
)
from zeroshop_steps.detect.mask_proposals import add_network_arguments, load_networks
from zeroshop_steps.detect.templates import Templates
from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.networks.devices import DEVICES, choose_device

Box = tuple[int, int, int, int]
"""Left, top, right and bottom in whole pixels."""
VISIBLE_COSINE = 0.5  # of a view's patch with the most similar patch of a region; the region shows patches with more
NO_DEPTH = "and this detector needs depth: add depth images, or use --method cnos, which needs colour only"
LEAST_MEANING = 0.2  # mean cosine of the class tokens; regions with less show no object
MODEL_POINTS = 2048  # whose box is compared with that of the region

METHOD = {
    "title": "SAM-6D ISM",
    "rank": 2,
    "models": {"describer": ("dinov2-large", ("config.json", "model.safetensors"))},
    "choices": {"proposals": {"sam": ("sam-vit-huge/model.safetensors", "sam-vit-huge/config.json"), "fastsam": ("FastSAM-x.pt",)}},
    "mem_mb": 12000,
    "runtime_min": 240,
}


@dataclass(frozen=True)
class ObjectViews:
    """What is known of one object, seen from V sides.

    Attributes:
        wholes: (V, D) unit vectors.
        patches: (V, P, D) unit vectors, 0 outside the object.
        rotations: (V, 3, 3) camera_from_model.
        points_mm: (N, 3) on the surface, about the middle of the model's box.
    """

    wholes: np.ndarray
    patches: np.ndarray
    rotations: np.ndarray
    points_mm: np.ndarray


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_image_arguments(parser)
    add_network_arguments(parser)
    parser.add_argument("--device", choices=DEVICES, default="auto", help="(default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Detect the models of a folder in the images of a split."""
    detect_in_files(args, prepare)


def prepare(args: argparse.Namespace, models: dict[int, ObjectModel], views_of: ViewsOf) -> Detector:
    """The detector of these models, with its networks loaded."""
    device = torch.device(choose_device(args.device))
    warn_of_plain_models(models)
    propose, describer = load_networks(args, device)
    objects = {number: describe_object(model, views_of(number), describer) for number, model in models.items()}

    def detect(frame: Frame) -> list[ObjectMask]:
        photo = read_photo(frame)
        depth_mm = read_depth(frame, photo, NO_DEPTH)
        return find_objects(propose(photo), photo, depth_mm, frame.intrinsics, describer, objects)

    return detect


def describe_object(model: ObjectModel, views: Templates, describer: CropDescriber) -> ObjectViews:
    """One model."""
    wholes, patches = describer.describe_patches(list(zip(views.colors, views.masks, strict=True)))
    points, _, _ = sample_surface(model.mesh, MODEL_POINTS, np.random.default_rng(0))
    middle = (model.mesh.vertices.min(0) + model.mesh.vertices.max(0)) / 2
    return ObjectViews(wholes, patches, views.camera_from_model[:, :3, :3], points - middle)


def find_objects(
    masks: list[np.ndarray],
    photo: np.ndarray,
    depth_mm: np.ndarray,
    intrinsics: np.ndarray,
    describer: CropDescriber,
    objects: dict[int, ObjectViews],
) -> list[ObjectMask]:
    """Assign each mask to the object that it resembles most, score it, and suppress double detections of an object by their boxes.

    Args:
        masks: (height, width) bool, not empty.
        photo: (height, width, 3) uint8.
        depth_mm: (height, width) measured, 0 where there is none.
        intrinsics: (3, 3) BOP's K.
        describer: of crops.
        objects: by number.
    """
    if not masks:
        return []
    wholes, patches = describer.describe_patches([(photo, mask) for mask in masks])
    meanings = score_objects(wholes, [one.wholes for one in objects.values()])
    numbers = np.array(list(objects))[meanings.argmax(1)]
    found: dict[int, list[ObjectMask]] = {number: [] for number in objects}
    for index, mask in enumerate(masks):
        meaning, known = float(meanings[index].max()), objects[int(numbers[index])]
        if meaning <= LEAST_MEANING:
            continue
        view = int(compare_views(wholes[index : index + 1], known.wholes)[0].argmax())
        geometry = _score_geometry(mask, depth_mm, intrinsics, known, view)
        visible = measure_visible_ratio(patches[index], known.patches[view])
        appearance = score_appearance(patches[index], known.patches[view])
        score = combine_scores(meaning, appearance, geometry, visible)
        found[int(numbers[index])].append(ObjectMask(int(numbers[index]), score, mask))
    return [one for mine in found.values() for one in _without_doubles(mine)]


def _score_geometry(mask: np.ndarray, depth_mm: np.ndarray, intrinsics: np.ndarray, known: ObjectViews, view: int) -> float:
    """0..1: how well the box of the mask agrees with that of the model, whose middle is put where the measured points are in the mean.

    Without any depth in the mask it is 0.
    """
    rows, columns = np.nonzero(mask & (depth_mm > 0))
    if not len(rows):
        return 0.0
    rays = np.stack([columns, rows, np.ones_like(rows)], 1) @ np.linalg.inv(intrinsics).T
    place_mm = (rays * depth_mm[rows, columns][:, None]).mean(0)
    left, top, width, height = mask_to_box(mask)
    expected = project_box(known.points_mm, known.rotations[view], place_mm, intrinsics, (mask.shape[1], mask.shape[0]))
    return overlap_boxes(expected, (left, top, left + width - 1, top + height - 1))


def _without_doubles(found: list[ObjectMask]) -> list[ObjectMask]:
    boxes = np.array([mask_to_box(one.mask) for one in found], float).reshape(-1, 4)
    return [found[index] for index in suppress_boxes(boxes, np.array([one.score for one in found]), MOST_IOU)]


def compare_views(regions: np.ndarray, views: np.ndarray) -> np.ndarray:
    """(N, V) cosines, 0..1, of (N, D) and (V, D) unit vectors."""
    return np.clip(regions @ views.T, 0.0, 1.0)


def score_appearance(region: np.ndarray, view: np.ndarray) -> float:
    """0..1: the mean cosine of a region's patches with the most similar ones of a view (equation 3).

    Args:
        region: (P, D) unit vectors, 0 for patches outside the mask.
        view: (Q, D), likewise.
    """
    likeness = (region @ view.T).max(1)
    shown = np.count_nonzero(region.any(1))
    return float(np.clip(likeness.sum() / max(shown, 1), 0.0, 1.0))


def measure_visible_ratio(region: np.ndarray, view: np.ndarray) -> float:
    """0..1: the share of a view's patches that a region shows (equation 5); arguments as in `score_appearance`."""
    likeness = (region @ view.T).max(0)  # 0 for patches outside the view's mask
    return float((likeness > VISIBLE_COSINE).sum() / max(np.count_nonzero(likeness), 1))


def project_box(points_mm: np.ndarray, rotation: np.ndarray, place_mm: np.ndarray, intrinsics: np.ndarray, size_px: tuple[int, int]) -> Box:
    """The box around a model that stands at a place, within the image.

    Args:
        points_mm: (N, 3) on the model, about its middle.
        rotation: (3, 3) camera_from_model.
        place_mm: (3,) of its middle, in front of the camera.
        intrinsics: (3, 3) BOP's K.
        size_px: (width, height) of the image.
    """
    projected = (points_mm @ rotation.T + place_mm) @ intrinsics.T
    pixels = (projected[:, :2] / projected[:, 2:]).astype(int).clip(0, np.array(size_px) - 1)
    (left, top), (right, bottom) = pixels.min(0).tolist(), pixels.max(0).tolist()
    return left, top, right, bottom


def overlap_boxes(one: Box, other: Box) -> float:
    """Intersection over union of two boxes.

    In the published code, one region whose boxes do not meet sets the overlap of all regions of the image to 0; here it sets its own.
    """
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    if width <= 0 or height <= 0:
        return 0.0
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (one, other)]
    return width * height / (sum(areas) - width * height)


def combine_scores(meaning: float, appearance: float, geometry: float, visible_ratio: float) -> float:
    """The score of a detection (equation 6): geometry counts as far as the object is visible."""
    return (meaning + appearance + geometry * visible_ratio) / (2.0 + visible_ratio)
