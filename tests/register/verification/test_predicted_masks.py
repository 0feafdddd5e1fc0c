"""Cameras that few points hold are checked by masks of a network: wrong ones are refused."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.ball_scene import ball_cameras, ball_mask, write_ball_scene
from register.refinement.test_silhouette_misses import shifted
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.networks.saliency.saliency_maps import WIDTH_PX, find_maps
from zeroshop_steps.register.scene.record import RegistrationFailed
from zeroshop_steps.register.verification.predicted_masks import check_by_predicted_masks, is_sparse


def network_of(masks):
    """A network that answers with these masks."""
    maps = [np.float32(mask) for mask in masks]
    return SimpleNamespace(
        name="saliency.onnx", path=Path("saliency.onnx"), find_maps=lambda paths, width_px: maps, describe=lambda: {"sha256": "of this one"}
    )


def test_thin_is_what_few_points_hold():
    figures = {"registered": 20, "mean_track_length": 4.0}
    assert is_sparse(figures | {"points": 500}) and not is_sparse(figures | {"points": 5000})


def test_right_cameras_pass_and_what_the_network_saw_is_kept(tmp_path):
    masks = write_ball_scene(tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    record = check_by_predicted_masks(tmp_path, {"registered": 12}, network_of([masks[0] & False, *masks[1:]]), 0.5)
    assert record["checked_by"] == "saliency.onnx" and record["outlines_miss_px"] < 3 and record["registered"] == 12
    assert sorted([*before, "saliency"]) == sorted(path.name for path in tmp_path.iterdir())
    asked = []
    network = network_of([])
    network.find_maps = lambda paths, width_px: asked.extend(paths) or [np.zeros((3, 4), np.float32)] * len(paths)
    images = sorted((tmp_path / "images").iterdir())
    (tmp_path / "saliency/000004.png").unlink()
    found = find_maps(tmp_path, network, images, WIDTH_PX)
    assert [path.name for path in asked] == ["000004.png"]
    assert all((one > 0.5).sum() == mask.sum() for index, (one, mask) in enumerate(zip(found, masks, strict=True)) if index not in (0, 4))
    network.describe = lambda: {"sha256": "of another"}
    find_maps(tmp_path, network, images, WIDTH_PX)
    assert asked[1:] == images


def test_wrong_cameras_are_refused(tmp_path):
    masks = write_ball_scene(tmp_path)
    bent = [shifted(camera, 0.15 * np.cos(index * 2.0)) for index, camera in enumerate(ball_cameras())]
    write_cameras(tmp_path / "sparse", bent)
    with pytest.raises(RegistrationFailed, match="incorrect, or masks are: .* px or more .of 1000"):
        check_by_predicted_masks(tmp_path, {"registered": 12}, network_of(masks), 0.5)


def test_photos_in_which_the_network_sees_nothing_are_not_judged(tmp_path):
    write_ball_scene(tmp_path)
    empty = [np.zeros_like(ball_mask(camera)) for camera in ball_cameras()]
    record = check_by_predicted_masks(tmp_path, {"registered": 12}, network_of(empty), 0.5)
    assert record["outlines_miss_px"] is None and "disagreeing" not in record
