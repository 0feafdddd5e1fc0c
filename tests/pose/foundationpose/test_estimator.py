"""The geometry around the networks: with networks that know the truth up to noise, the true pose must come out."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from helpers.printed_box import INTRINSICS, make_box, view
from helpers.true_networks import TrueNetworks
from zeroshop_steps.bop.formats.models import ObjectModel
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd
from zeroshop_steps.pose.foundationpose import estimator
from zeroshop_steps.pose.foundationpose.estimator import FoundationPoseModel, PoseEstimator

CPU = torch.device("cpu")
TURN_DEG = 2.0
"""Size of the errors of the networks that know the truth."""


@pytest.fixture(scope="module")
def model() -> ObjectModel:
    return make_box()


@pytest.fixture(scope="module")
def ready(model) -> FoundationPoseModel:
    """With some 20 hypotheses, 70 degrees apart, instead of 252."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(estimator, "SAME_TURN_DEG", 70.0)
        return FoundationPoseModel(model, CPU)


def alike_by_shape(pose: np.ndarray) -> np.ndarray:
    """(4, 4, 4) the pose of a box, and it turned upside down about each axis: only the print tells them apart."""
    turns = np.tile(np.eye(4), (4, 1, 1))
    turns[1:, :3, :3] = Rotation.from_rotvec(np.pi * np.eye(3)).as_matrix()
    return pose @ turns


def error_in_diameters(found: np.ndarray, pose: np.ndarray, model: ObjectModel) -> float:
    return float(mssd(found[None], pose[None], ModelPoints.from_vertices(model.mesh.vertices), model.symmetries)[0]) / model.diameter_mm


@torch.inference_mode()
@pytest.mark.parametrize(("seed", "hidden"), [(1, False), (2, True), (3, False)])
def test_a_box_is_found_whatever_side_is_up_and_half_hidden_too(model, ready, seed, hidden):
    pose, photo, depth, mask = view(model, seed, hidden)
    networks = TrueNetworks(alike_by_shape(pose), ready, TURN_DEG)
    found = PoseEstimator(networks, CPU).register(mask, photo, depth, INTRINSICS, ready)
    assert networks.refined == 5 * len(ready.rotations)
    assert error_in_diameters(found, pose, model) < 0.05
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
