"""FoundationPose (Wen et al., CVPR 2024): a network moves poses until their renderings fit the photo, another picks the best.

The model is turned every way, 42 directions with six in-plane rotations each, and put where the mask and its depth are. A network
compares a rendering of each of these poses with the photo, in colour and depth, and moves the pose, five times. Another one ranks
them all. Needs two files of weights below resources/weights/foundationpose, which forbid commercial use; `foundationpose_onnx` is the
same with files that allow it, and `render_compare` needs no weights. Writes BOP's result CSV; the score is that of the detection.
"""

import argparse
import functools

from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.networks.foundationpose.model import SIZES
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER, resolve_weights
from zeroshop_steps.pose import dataset
from zeroshop_steps.pose.foundationpose.networks import TorchNetworks
from zeroshop_steps.pose.foundationpose.steps import add_common_arguments, prepare_estimator

WEIGHTS = ("foundationpose/2023-10-28-18-33-37/model_best.pth", "foundationpose/2024-01-11-20-02-45/model_best.pth")

METHOD = {
    "title": "FoundationPose",
    "weights": ("foundationpose/2023-10-28-18-33-37/model_best.pth", "foundationpose/2024-01-11-20-02-45/model_best.pth"),
    "mem_mb": 4000,
    "runtime_min": 1440,
    "threads": 8,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_common_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Estimate the poses of all detections in the target images."""
    dataset.run_estimator(args, functools.partial(prepare, args), spare=0)


def prepare(args: argparse.Namespace, models: dict[int, ObjectModel]) -> dataset.Estimator:
    """The estimator of the poses of these models."""
    return prepare_estimator(
        args, models, lambda device: TorchNetworks([resolve_weights(WEIGHTS_FOLDER / name, name, SIZES) for name in WEIGHTS], device)
    )
