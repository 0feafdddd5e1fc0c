"""What FoundationPose's steps share: their options, and estimating the poses of a dataset."""

import argparse
from collections.abc import Callable

import numpy as np
import torch

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.bop.formats.detections import Detection
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.geometry.meshes.units import MM_PER_M
from zeroshop_steps.networks.devices import DEVICES, choose_device, run_network
from zeroshop_steps.pose import dataset
from zeroshop_steps.pose.foundationpose.estimator import FoundationPoseModel, PoseEstimator
from zeroshop_steps.pose.foundationpose.networks import PairNetworks
from zeroshop_steps.runtime.errors import warn

ITERATIONS = 5  # refinements of each hypothesis, where nothing else is asked


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of all estimators, and those of FoundationPose."""
    dataset.add_arguments(parser)
    add_network_arguments(parser)
    parser.add_argument("--iterations", type=int, default=ITERATIONS, help="refinements of each hypothesis (default: %(default)s)")


def add_network_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the networks run, and what they see."""
    parser.add_argument("--depth-cut-m", type=float, default=1.5, help="ignore what is farther from the camera (default: %(default)s)")
    parser.add_argument("--device", choices=DEVICES, default="auto", help="(default: %(default)s)")


def prepare_estimator(
    args: argparse.Namespace, models: dict[int, ObjectModel], load: Callable[[torch.device], PairNetworks]
) -> dataset.Estimator:
    """The estimator of the poses of these models, with the networks that `load` makes; the score of a pose is that of its detection.

    The networks' scores only tell which of the poses of one detection is best, so that detections cannot be compared by them.
    """
    device = torch.device(choose_device(args.device))
    estimator = PoseEstimator(load(device), device, args.iterations, MM_PER_M * args.depth_cut_m)
    ready = prepare_models(models, estimator.device)

    def estimate(
        detection: Detection, mask: np.ndarray, photo: np.ndarray, depth_mm: np.ndarray, frame: Frame
    ) -> tuple[np.ndarray, float] | None:
        with run_network(estimator.device, "FoundationPose"):
            pose = estimator.register(mask, photo, depth_mm, frame.intrinsics, ready[detection.object_id])
        return None if pose is None else (pose, detection.score)

    return estimate


def prepare_models(models: dict[int, ObjectModel], device: torch.device) -> dict[int, FoundationPoseModel]:
    """The models on the device; warns of those without any colour."""
    plain = [number for number, model in models.items() if not model.mesh.is_colored]
    if plain:
        warn(f"the models of the objects {plain} have no texture or colours; the networks cannot tell alike sides apart")
    return {number: FoundationPoseModel(model, device) for number, model in models.items()}
