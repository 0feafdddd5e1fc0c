"""FoundationPose's networks in small sizes with random weights, in files like the published ones."""

import warnings
from pathlib import Path

import torch
from torch import nn

from helpers.foundationpose_cases import SMALL, parameters
from zeroshop_steps.networks.foundationpose.model import SIZES, RefineNet, ScoreNet
from zeroshop_steps.networks.foundationpose.settings import CROP_PX, FoundationPoseSettings
from zeroshop_steps.pose import foundationpose, foundationpose_onnx
from zeroshop_steps.runtime.files import write_json

OUTPUTS = {RefineNet: ["trans", "rot"], ScoreNet: ["score_logit"]}


def make_network(kind: type[nn.Module]) -> nn.Module:
    """A small refiner or scorer with the parameters of foundationpose_cases."""
    network = kind(FoundationPoseSettings(**SMALL))
    network.load_state_dict(parameters(network.state_dict()))
    return network.eval()


def write_checkpoints(root: Path) -> list[Path]:
    """The two checkpoints below `root`/resources/weights, with their sizes beside them."""
    paths = [root / "resources/weights" / name for name in foundationpose.WEIGHTS]
    for path, kind in zip(paths, (RefineNet, ScoreNet), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        torch.save({"model": make_network(kind).state_dict(), "epoch": 1}, path)
        write_json(path.with_suffix(SIZES), SMALL)
    return paths


def write_onnx(root: Path, pairs: int) -> list[Path]:
    """The same networks as the hub's ONNX files below `root`/resources/weights; this export's scorer takes so many pairs alone."""
    paths = [root / "resources/weights" / name for name in foundationpose_onnx.WEIGHTS]
    for path, kind in zip(paths, (RefineNet, ScoreNet), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        images = torch.zeros(pairs, 6, CROP_PX, CROP_PX)
        names = ["inputA", "inputB"]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                make_network(kind), (images, images), path, input_names=names, output_names=OUTPUTS[kind], opset_version=17, dynamo=False,
                dynamic_axes={name: {0: "batch"} for name in (*names, *OUTPUTS[kind])},
            )  # fmt: skip
    return paths
