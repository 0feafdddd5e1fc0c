"""FoundationPose with the ONNX files that NVIDIA publishes for commercial use too; else as `foundationpose`.

Needs the folder foundationpose-onnx below resources/weights. The networks run in onnxruntime, on the processor unless its build for
CUDA is installed.
"""

import argparse
import functools

from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.networks.weights import require_weights
from zeroshop_steps.pose import dataset
from zeroshop_steps.pose.foundationpose.networks import OnnxNetworks
from zeroshop_steps.pose.foundationpose.steps import add_common_arguments, prepare_estimator

WEIGHTS = ("foundationpose-onnx/refiner_net.onnx", "foundationpose-onnx/score_net.onnx")

METHOD = {
    "title": "FoundationPose, ONNX",
    "weights": ("foundationpose-onnx/refiner_net.onnx", "foundationpose-onnx/score_net.onnx"),
    "mem_mb": 8000,
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
    return prepare_estimator(args, models, lambda device: OnnxNetworks([require_weights(name) for name in WEIGHTS], device))
