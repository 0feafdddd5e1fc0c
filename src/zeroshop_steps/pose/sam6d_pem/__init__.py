"""The pose estimation of SAM-6D (Lin et al., SAM-6D: Segment Anything Model Meets Zero-Shot 6D Object Pose Estimation, CVPR 2024).

A network gives every pixel of a crop a feature, as it gives those of 42 views of the model. A few points of the image and of the model
are matched first: of many poses by three pairs each, the one that lays the image's points nearest to the model is taken. Then all
points are matched, and the pose that fits all pairs is the answer. Needs RGB-D and weights; `render_compare` needs none. Writes
BOP's result CSV. The score of a pose is the share of the points that it explains, times the score of the detection.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import Detection
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.detect.detector_io import warn_of_plain_models
from zeroshop_steps.detect.templates import Templates, read_templates
from zeroshop_steps.geometry.alignment.surface_distance import sample_surface
from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.networks.devices import DEVICES, PROCESS_BYTES, MemoryNeeds, check_memory, choose_device, run_network
from zeroshop_steps.networks.sam6d.embedding import BALL_CHANNELS, BALLS
from zeroshop_steps.networks.sam6d.model import NAME, SIZES, KnownObject, Sam6dPem, load_sam6d_pem
from zeroshop_steps.networks.sam6d.points import sample_farthest
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, resolve_weights
from zeroshop_steps.pose import dataset
from zeroshop_steps.pose.sam6d_pem.crops import PointCrop, crop_observation, crop_view
from zeroshop_steps.runtime.progress import track

MODEL_POINTS = 1024  # of the whole surface, near which the image's points must lie
LEAST_SCORE = 0.25  # of a detection; those with less are not looked at
GROUP_COPIES, PAIR_COPIES = 5, 6  # of the largest arrays that are there at once; 1.6 GB were measured, 1.9 GB are foreseen

METHOD = {
    "title": "SAM-6D PEM",
    "rank": 110,
    "weights": ("sam-6d-pem-base.pth",),
    "mem_mb": 4000,
    "runtime_min": 240,
    "threads": 2,
    "templates": True,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    dataset.add_arguments(parser)
    parser.add_argument("--templates", type=Path, required=True, help="views of the models, written by detect --method templates")
    parser.add_argument("--weights", type=Path, default=WEIGHTS_FOLDER / NAME, help="the network's weights (default: %(default)s)")
    parser.add_argument("--device", choices=DEVICES, default="auto", help="(default: %(default)s)")


def run(args: argparse.Namespace) -> None:
    """Estimate the poses of all detections in the target images."""
    dataset.run_estimator(args, lambda models: prepare(args, models, lambda number: read_templates(args.templates, number)))


def prepare(args: argparse.Namespace, models: dict[int, ObjectModel], views_of: Callable[[int], Templates]) -> dataset.Estimator:
    """The estimator of the poses of these models, with its network loaded."""
    weights = resolve_weights(args.weights, NAME, SIZES)
    device = torch.device(choose_device(args.device))
    network = load_sam6d_pem(weights)
    warn_of_plain_models(models)
    check_memory(predict_memory(network, len(models)), device)
    network = network.to(device)
    known = {
        number: know_object(model, views_of(number), network, device) for number, model in track(models.items(), "objects", len(models))
    }

    def estimator(
        detection: Detection, mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, frame: Frame
    ) -> tuple[np.ndarray, float] | None:
        if detection.score <= LEAST_SCORE:
            return None
        model = models[detection.object_id]
        crop = crop_observation(photo, depth_mm, mask, frame.intrinsics, model.diameter_mm, np.random.default_rng(0))
        if crop is None:
            return None
        camera_from_model, score = estimate_pose(crop, known[detection.object_id], network, device)
        return camera_from_model, score * detection.score

    return estimator


def predict_memory(network: Sam6dPem, objects: int) -> MemoryNeeds:
    """Memory at the peak: the weights, what is known of the objects, and one detection in the matching of all its points."""
    settings, parameters = network.settings, sum(parameter.numel() for parameter in network.parameters())
    known = objects * (settings.dense_points * (settings.features + 3) + 3 * MODEL_POINTS)
    grouped = settings.dense_points * sum(count for _, count in BALLS) * BALL_CHANNELS[-1]
    pairs = (settings.sparse_points + 1) ** 2 * settings.channels
    peak = PROCESS_BYTES + 4 * (parameters + known + GROUP_COPIES * grouped + PAIR_COPIES * pairs)
    return MemoryNeeds(peak, f"SAM-6D's pose estimation of {objects} objects", "free memory, or use render_compare, which needs 3 GB")


def know_object(model: ObjectModel, views: Templates, network: Sam6dPem, device: torch.device) -> KnownObject:
    """Points of a model that its views show, evenly spread, with their features, and points of all its surface.

    The points are chosen before their features are made, so that those of all views never have to be kept at once.
    """
    rng = np.random.default_rng(0)
    crops = [crop_view(views, index, rng) for index in range(len(views.depths_mm))]
    points = torch.from_numpy(np.concatenate([crop.points_mm for crop in crops]) / MM_PER_M).float()
    kept = sample_farthest(points[None].to(device), network.settings.dense_points)[0].cpu()
    view, place = kept // len(crops[0].chosen), kept % len(crops[0].chosen)
    features = torch.zeros(len(kept), network.settings.features)
    for index, crop in enumerate(crops):
        mine = view == index
        features[mine] = _describe(crop, torch.from_numpy(crop.chosen)[place[mine]], network, device)[0].cpu()
    surface, _, _ = sample_surface(model.mesh, MODEL_POINTS, rng)
    parts = points[kept], features, torch.from_numpy(surface / MM_PER_M).float()
    return KnownObject(*(part[None].to(device) for part in parts))


def estimate_pose(crop: PointCrop, known: KnownObject, network: Sam6dPem, device: torch.device) -> tuple[np.ndarray, float]:
    """(4, 4) camera_from_model in mm and its score, 0..1."""
    features = _describe(crop, torch.from_numpy(crop.chosen), network, device)
    points = torch.from_numpy(crop.points_mm / MM_PER_M).float()[None].to(device)
    draws = torch.rand(1, 3 * network.settings.hypotheses, generator=torch.Generator().manual_seed(0)).to(device)
    with run_network(device, "SAM-6D's pose estimation"):
        found = network(points, features, known, draws)
    pose = make_transform(found.rotations[0].double().cpu().numpy(), MM_PER_M * found.places[0].double().cpu().numpy())
    return pose, float(found.scores[0])


def _describe(crop: PointCrop, chosen: Tensor, network: Sam6dPem, device: torch.device) -> Tensor:
    """(1, N, C) features of pixels of a crop."""
    with run_network(device, "SAM-6D's pose estimation"):
        return network.describe(torch.from_numpy(crop.image)[None].to(device), chosen[None].to(device)).float()
