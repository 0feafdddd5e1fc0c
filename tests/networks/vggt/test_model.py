"""Our VGGT answers as the published one does: same parameters, same inputs, outputs within 1e-4 (../../parity/README.md)."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.named_parameters import fill
from helpers.paths import PARITY
from helpers.small_vggt import SETTINGS
from zeroshop_steps.networks.vggt.model import Vggt
from zeroshop_steps.networks.vggt.settings import VggtSettings

USUAL = VggtSettings()
SMALL = replace(SETTINGS, image_px=70, track_depth=USUAL.track_depth, virtual_tracks=USUAL.virtual_tracks)
SIZE_PX = (42, 70)
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def network():
    with torch.inference_mode():
        yield fill(Vggt(SMALL))


def recorded(name: str) -> dict[str, torch.Tensor]:
    with np.load(PARITY / f"vggt_{name}.npz") as values:
        return {key: torch.from_numpy(values[key]) for key in values}


def assert_same(ours: torch.Tensor, theirs: torch.Tensor) -> None:
    """Relative to the size of all values together: single ones may be near zero."""
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype
    assert ours.isfinite().all() and theirs.std() > 1e-3
    assert float((ours - theirs).norm() / theirs.norm()) < TOLERANCE


def test_full_size_has_the_names_and_shapes_of_the_checkpoint():
    with torch.device("meta"):
        network = Vggt()
    lines: dict[str, int] = {}
    for name, parameter in network.named_parameters():
        line = re.sub(r"(blocks|trunk)\.\d+\.", r"\1.*.", name) + " " + "x".join(map(str, parameter.shape))
        lines[line] = lines.get(line, 0) + 1
    expected = (PARITY / "vggt_parameters.txt").read_text().splitlines()
    assert [f"{count} {line}" for line, count in sorted(lines.items())] == expected
    assert set(network.state_dict()) == {name for name, _ in network.named_parameters()}
    assert sum(parameter.numel() for parameter in network.parameters()) == 1_256_537_516


def test_patch_embed(network):
    expected = recorded("patch_embed")
    assert_same(network.aggregator.patch_embed(expected["images"]), expected["tokens"])


def test_aggregator(network):
    expected = recorded("aggregator")
    assert_same(torch.stack(network.aggregator(expected["images"])), expected["layers"])


def test_camera_head(network):
    expected = recorded("camera_head")
    assert_same(network.camera_head(expected["tokens"]), expected["encodings"])


@pytest.mark.parametrize("chunk", [1, 2, 8])
def test_dense_heads_however_many_frames_go_together(network, chunk):
    expected = recorded("depth_head")
    depth = network.depth_head(list(expected["layers"]), SIZE_PX, chunk)
    assert_same(depth[:, :1].exp().permute(0, 2, 3, 1), expected["values"])
    assert_same(1 + depth[:, 1].exp(), expected["confidence"])
    expected = recorded("point_head")
    points = network.point_head(list(expected["layers"]), SIZE_PX, chunk).permute(0, 2, 3, 1)
    assert_same(points[..., :3].sign() * points[..., :3].abs().expm1(), expected["values"])
    assert_same(1 + points[..., 3].exp(), expected["confidence"])
    expected = recorded("track_features")
    assert_same(network.track_head.feature_extractor(list(expected["layers"]), SIZE_PX, chunk), expected["features"])


@pytest.mark.parametrize("volume_values", [1, 1 << 27])
def test_tracker_however_many_points_go_together(network, monkeypatch, volume_values):
    monkeypatch.setattr("zeroshop_steps.networks.vggt.track_head.VOLUME_VALUES", volume_values)
    expected = recorded("tracker")
    tracks = network.track_head.tracker(expected["maps"], expected["query"])
    assert_same(tracks.xy, expected["xy"])
    assert_same(tracks.visibility, expected["visibility"])
    assert_same(tracks.confidence, expected["confidence"])


def test_tracker_with_large_corrections():
    expected = recorded("tracker_far")
    with torch.inference_mode():
        tracker = fill(Vggt(SMALL)).track_head.tracker
        for parameter in tracker.updateformer.flow_head.parameters():
            parameter *= 100
        given = recorded("tracker")
        tracks = tracker(given["maps"], given["query"], rounds=2)
    assert float((tracks.xy[1:] - tracks.xy[:1]).abs().max()) > 5.0
    assert_same(tracks.xy, expected["xy"])
    assert_same(tracks.visibility, expected["visibility"])
    assert_same(tracks.confidence, expected["confidence"])


def test_whole_network(network):
    expected = recorded("whole")
    found = network(expected["images"], expected["query"])
    assert_same(found.encodings, expected["pose_enc"])
    assert_same(found.depth[..., None], expected["depth"])
    assert_same(found.depth_confidence, expected["depth_conf"])
    assert_same(found.points, expected["world_points"])
    assert_same(found.point_confidence, expected["world_points_conf"])
    assert_same(found.tracks.xy, expected["track"])
    assert_same(found.tracks.visibility, expected["vis"])
    assert_same(found.tracks.confidence, expected["conf"])
