"""An object is followed through a film, one refinement a frame."""

import shutil

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from helpers.printed_box import INTRINSICS, make_box, taken
from helpers.small_dataset import BOX, CAN, dataset_in, make_dataset
from helpers.small_foundationpose import write_checkpoints
from helpers.true_networks import TrueNetworks
from zeroshop_steps.bop.formats.estimates import read_estimates
from zeroshop_steps.bop.formats.targets import Target, write_targets
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd
from zeroshop_steps.pose.foundationpose import estimator
from zeroshop_steps.pose.foundationpose.estimator import FoundationPoseModel, PoseEstimator
from zeroshop_steps.runtime.cli import stage_main

CPU = torch.device("cpu")


@torch.inference_mode()
def test_a_box_that_moves_is_followed_with_one_refinement_a_frame(monkeypatch):
    monkeypatch.setattr(estimator, "SAME_TURN_DEG", 120.0)
    model = make_box()
    ready = FoundationPoseModel(model, CPU)
    pose, rng = np.eye(4), np.random.default_rng(0)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", [200, 20, 40], degrees=True).as_matrix(), [-30, 10, 700]
    found = pose
    for _ in range(5):
        pose = pose.copy()
        pose[:3, :3] = Rotation.from_rotvec([0.05, 0.1, -0.05]).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += [12, -4, 8]
        networks = TrueNetworks(pose[None], ready, turn_deg=1.0)
        photo, depth, _ = taken(model, pose, rng)
        found = PoseEstimator(networks, CPU).track(found, photo, depth, INTRINSICS, ready)
        assert networks.refined == 1
        error_mm = mssd(found[None], pose[None], ModelPoints.from_vertices(model.mesh.vertices), model.symmetries)[0]
        assert error_mm < 0.03 * model.diameter_mm


@pytest.fixture
def film(tmp_path, monkeypatch):
    """A scene of two images, and small random weights."""
    write_checkpoints(tmp_path)
    make_dataset(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(estimator, "SAME_TURN_DEG", 120.0)
    return dataset_in(tmp_path)


def follow(film):
    out = film.folder / "track.csv"
    given = ["--models", film.folder / "models", "--scenes", film.scenes, "--targets", film.targets_path, "--out", out]
    words = ["--method", "foundationpose_tracking", *map(str, given), "--device", "cpu", "--iterations", "1"]
    return stage_main("zeroshop_steps.pose", words), out


def test_every_object_of_the_first_image_has_a_pose_in_every_image(film):
    status, out = follow(film)
    poses = read_estimates(out)
    assert status == 0
    assert sorted(zip(poses.image_ids.tolist(), poses.object_ids.tolist(), strict=True)) == [(0, BOX), (0, CAN), (1, BOX), (1, CAN)]


def test_a_film_without_targets_in_its_first_image_or_without_depth_is_refused(film, capsys):
    shutil.rmtree(film.scenes / "000001/depth")
    assert follow(film)[0] == 1 and "poses are estimated from depth: add it" in capsys.readouterr().err
    write_targets(film.targets_path, [Target(1, 1, BOX, 1)])
    assert follow(film)[0] == 1 and "asks for nothing in scene 1, image 0, where following begins" in capsys.readouterr().err
