"""Our Depth Anything 3 answers as the published one does: same parameters, same inputs, outputs within 1e-4 (../../parity/README.md)."""

import re
from collections import Counter

import numpy as np
import pytest
import torch

from helpers import da3_cases as cases
from helpers.named_parameters import fill
from helpers.paths import PARITY
from helpers.small_da3 import SETTINGS
from zeroshop_steps.networks.da3 import backbone
from zeroshop_steps.networks.da3.backbone import choose_reference
from zeroshop_steps.networks.da3.camera_tokens import invert_encodings
from zeroshop_steps.networks.da3.model import DepthAnything3
from zeroshop_steps.networks.da3.settings import BASE, SMALL

TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def network():
    with torch.inference_mode():
        yield fill(DepthAnything3(SETTINGS))


@pytest.fixture(scope="module")
def recorded() -> dict[str, torch.Tensor]:
    with np.load(PARITY / "da3.npz") as values:
        return {key: torch.from_numpy(values[key]) for key in values}


def assert_same(ours: torch.Tensor, theirs: torch.Tensor) -> None:
    """Relative to the size of all values together: single ones may be near zero."""
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype
    assert ours.isfinite().all() and theirs.std() > 1e-3
    assert float((ours - theirs).norm() / theirs.norm()) < TOLERANCE


def test_both_sizes_have_the_names_and_shapes_of_the_checkpoints():
    with torch.device("meta"):
        shapes = [{name: "x".join(map(str, p.shape)) for name, p in DepthAnything3(size).state_dict().items()} for size in (SMALL, BASE)]
    lines = Counter(re.sub(r"(blocks|trunk)\.\d+\.", r"\1.*.", f"{name} {shape} {shapes[1][name]}") for name, shape in shapes[0].items())
    assert [f"{count} {line}" for line, count in sorted(lines.items())] == (PARITY / "da3_parameters.txt").read_text().splitlines()
    assert len(shapes[0]) == len(shapes[1]) == 437  # tensors in DA3-SMALL/model.safetensors


@pytest.mark.parametrize("frames", [2, 4])
def test_backbone_with_the_first_and_with_a_chosen_reference(network, recorded, frames):
    tokens = network.backbone(cases.images()[:frames])
    assert_same(torch.stack(tokens.layers), recorded[f"backbone_{frames}.layers"])
    assert_same(tokens.camera, recorded[f"backbone_{frames}.camera"])


def test_the_reference_of_the_record_is_not_the_first(network, monkeypatch):
    """Or the order of the images would not be tested."""
    chosen = []
    monkeypatch.setattr(backbone, "choose_reference", lambda tokens: chosen.append(choose_reference(tokens)) or chosen[0])
    network.backbone(cases.images())
    assert [int(image) for image in chosen] == [1]


@pytest.mark.parametrize("chunk", [1, 3, 8])
def test_dual_head_however_many_frames_go_together(network, recorded, chunk):
    dense = network.head(cases.layers(), cases.SIZE_PX, chunk)
    assert_same(dense[:, 0].exp(), recorded["dual_head.depth"])
    assert_same(1 + dense[:, 1].exp(), recorded["dual_head.depth_conf"])
    rays = network.head.rays(cases.layers(), cases.SIZE_PX)
    assert_same(rays[:, :6].permute(0, 2, 3, 1), recorded["dual_head.ray"])
    assert_same(1 + rays[:, 6].exp(), recorded["dual_head.ray_conf"])


def test_cameras_from_tokens_and_tokens_from_cameras(network, recorded):
    assert_same(network.cam_dec(cases.inputs("camera", cases.FRAMES, 2 * cases.WIDTH)), recorded["camera_decoder.encodings"])
    assert_same(network.cam_enc(recorded["known"]), recorded["camera_encoder.tokens"])


@pytest.mark.parametrize("name", ["whole", "whole_known"])
def test_whole_network_without_and_with_known_cameras(network, recorded, name):
    found = network(cases.images(), recorded["known"] if name == "whole_known" else None)
    assert_same(found.depth, recorded[f"{name}.depth"])
    assert_same(found.depth_confidence, recorded[f"{name}.depth_conf"])
    assert found.rays.shape[1:] == (24, 40, 6) and found.ray_confidence.min() >= 1
    inverse = invert_encodings(found.encodings)
    poses = torch.cat([rotations(inverse[:, 3:7]), inverse[:, :3, None]], dim=2)
    assert_same(poses, recorded[f"{name}.extrinsics"])
    focal = torch.tensor(cases.SIZE_PX) / 2 / (found.encodings[:, 7:] / 2).tan().clamp(min=1e-6)
    assert_same(focal.flip(1), recorded[f"{name}.intrinsics"].diagonal(dim1=1, dim2=2)[:, :2])


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """(S, 3, 3) of (S, 4) unit quaternions x, y, z, w: columns are where the axes go."""
    axis, w = quaternions[:, None, :3].expand(-1, 3, -1), quaternions[:, None, 3:]
    units = torch.eye(3).expand(len(quaternions), -1, -1)
    turned = torch.linalg.cross(axis, units)
    return (units + 2 * (w * turned + torch.linalg.cross(axis, turned))).transpose(1, 2)
