"""A Depth Anything 3 of small sizes with random weights, in a file like the published ones."""

from dataclasses import asdict
from pathlib import Path

import torch
from safetensors.torch import save_file

from helpers import da3_cases as cases
from zeroshop_steps.networks.da3.model import PREFIX, DepthAnything3
from zeroshop_steps.networks.da3.settings import Da3Settings
from zeroshop_steps.runtime.files import write_json

SETTINGS = Da3Settings(
    image_px=cases.GRID * cases.PATCH_PX,
    grid=cases.GRID,
    width=cases.WIDTH,
    depth=cases.DEPTH,
    heads=cases.HEADS,
    alone=cases.ALONE,
    layers=cases.LAYERS,
    camera_depth=cases.CAMERA_DEPTH,
    camera_heads=cases.CAMERA_HEADS,
    dense_features=cases.FEATURES,
    dense_channels=cases.CHANNELS,
)


def write_weights(path: Path) -> Path:
    """Random weights that lead to possible cameras, so that nothing ends before they are used; returns `path`."""
    torch.manual_seed(0)
    network = DepthAnything3(SETTINGS)
    with torch.no_grad():
        network.backbone.pretrained.camera_token.normal_()
        for layer in (network.cam_dec.fc_qvec, network.cam_dec.fc_fov[0]):
            layer.weight.mul_(0.05)
        network.cam_dec.fc_t.weight.mul_(50.0)
        # Cameras at some distance and anywhere, hardly turned, 40 by 50 degrees.
        network.cam_dec.fc_t.bias.copy_(torch.tensor([0.0, 0.0, -2.0]))
        network.cam_dec.fc_qvec.bias.copy_(torch.tensor([0.0, 0.0, 0.0, 1.0]))
        network.cam_dec.fc_fov[0].bias.copy_(torch.tensor([0.7, 0.87]))
    path.parent.mkdir(parents=True)
    save_file({PREFIX + name: tensor for name, tensor in network.state_dict().items()}, path)
    write_json(path.with_suffix(".settings.json"), asdict(SETTINGS))
    return path
