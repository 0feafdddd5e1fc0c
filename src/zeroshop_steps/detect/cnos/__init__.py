"""CNOS (Nguyen et al., CNOS: A Strong Baseline for CAD-based Novel Object Segmentation, ICCVW 2023): SAM proposes, DINOv2 names.

Segment Anything proposes regions from a grid of points, or FastSAM in one pass. DINOv2's class token of each masked region is compared
with those of 42 views of every model, and the mean of the five nearest is the score. Uses colour only. Needs dinov2-large, and
sam-vit-huge or FastSAM-x.pt, below resources/weights; `contour` needs no weights. Writes BOP's COCO JSON.
"""

import argparse
from typing import Any

import numpy as np
import torch

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import mask_to_box
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.detect.cnos.crops import CropDescriber
from zeroshop_steps.detect.detector_io import (
    LEAST_CONFIDENCE,
    MOST_IOU,
    Detector,
    ObjectMask,
    ViewsOf,
    add_image_arguments,
    detect_in_files,
    read_photo,
    suppress_boxes,
    warn_of_plain_models,
)
from zeroshop_steps.detect.mask_proposals import add_network_arguments, load_networks
from zeroshop_steps.detect.templates import Templates
from zeroshop_steps.networks.devices import DEVICES, choose_device

NEAREST_VIEWS = 5  # whose mean cosine is the score of an object

METHOD: dict[str, Any] = {
    "rank": 1,
    "models": {"describer": ("dinov2-large", ("config.json", "model.safetensors"))},
    "choices": {"proposals": {"sam": ("sam-vit-huge/model.safetensors", "sam-vit-huge/config.json"), "fastsam": ("FastSAM-x.pt",)}},
    "mem_mb": 12000,
    "runtime_min": 240,
    "masks": "masks.json",
}


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
    views = {number: describe_views(views_of(number), describer) for number in models}

    def detect(frame: Frame) -> list[ObjectMask]:
        photo = read_photo(frame)
        return assign_objects(propose(photo), photo, describer, views)

    return detect


def describe_views(views: Templates, describer: CropDescriber) -> np.ndarray:
    """(views, D) unit vectors of the views of one model."""
    return describer.describe([(color, mask) for color, mask in zip(views.colors, views.masks, strict=True)])


def assign_objects(masks: list[np.ndarray], photo: np.ndarray, describer: CropDescriber, views: dict[int, np.ndarray]) -> list[ObjectMask]:
    """Assign each mask to the object that it resembles most, and suppress double detections of an object by their boxes."""
    masks = [mask for mask in masks if mask.any()]
    if not masks:
        return []
    scores = score_objects(describer.describe([(photo, mask) for mask in masks]), list(views.values()))
    numbers, best = np.array(list(views))[scores.argmax(1)], scores.max(1)
    boxes = np.array([mask_to_box(mask) for mask in masks], float)
    found = []
    for number in views:
        mine = np.flatnonzero((numbers == number) & (best > LEAST_CONFIDENCE))
        kept = mine[suppress_boxes(boxes[mine], best[mine], MOST_IOU)]
        found += [ObjectMask(number, float(best[index]), masks[index]) for index in kept]
    return found


def score_objects(regions: np.ndarray, views: list[np.ndarray]) -> np.ndarray:
    """(regions, objects) scores, 0..1: the mean cosine with the five nearest views of each object."""
    scores = []
    for vectors in views:
        cosines = np.sort(np.clip(regions @ vectors.T, 0, 1), axis=1)
        scores.append(cosines[:, -NEAREST_VIEWS:].mean(1))
    return np.stack(scores, 1)
