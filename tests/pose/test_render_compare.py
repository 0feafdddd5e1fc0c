"""A printed box is found again, print side and all, from its depth and colours, half of it hidden or not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zeroshop_steps.bop.distractors import distractor
from zeroshop_steps.bop.models import Model
from zeroshop_steps.bop.pose_error import ModelPoints, mssd
from zeroshop_steps.bop.scene import Frame
from zeroshop_steps.cameras import Camera
from zeroshop_steps.finish.render import MeshRenderer
from zeroshop_steps.pose.compare import Comparison
from zeroshop_steps.pose.hypotheses import PoseSearch
from zeroshop_steps.pose.render_compare import estimate, measured_points

INTRINSICS = np.array([[500.0, 0, 79.5], [0, 500.0, 59.5], [0, 0, 1]])


@pytest.fixture(scope="module")
def model() -> Model:
    rng = np.random.default_rng(5)
    mesh = next(mesh for mesh in iter(lambda: distractor(rng), None) if len(mesh.faces) == 12)
    return Model(1, mesh, float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))), np.eye(4)[None], {})


def view(model: Model, seed: int, hidden: bool):
    """(pose, photo, depth, mask) of the box before a wall, with 1 mm of noise."""
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(rng.normal(size=4)).as_matrix(), [8, -5, 700]
    camera = Camera("", 160, 120, INTRINSICS + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]), pose)
    renderer = MeshRenderer(model.mesh)
    depth = renderer.hits(camera).depth
    mask = depth > 0
    if hidden:
        mask[:, : int(np.median(np.nonzero(mask)[1]))] = False
    measured = np.where(depth > 0, depth, 950.0) + rng.normal(0, 1, depth.shape)
    measured[(depth > 0) & ~mask] = 500.0
    return pose, renderer.color(camera), measured.astype(np.float32), mask


@pytest.mark.parametrize(("seed", "hidden"), [(1, False), (2, True)])
def test_a_box_is_found_again(model, seed, hidden):
    pose, photo, depth, mask = view(model, seed, hidden)
    frame = Frame(1, 0, INTRINSICS, 0.1, None, (), None)
    found, score = estimate(mask, photo, depth, frame, PoseSearch(model.mesh, model.diameter_mm), Comparison(model.mesh), model)
    error_mm = mssd(found[None], pose[None], ModelPoints.of(model.mesh.vertices), model.symmetries)[0]
    assert error_mm < 0.05 * model.diameter_mm and 0.5 < score <= 1.0


def test_nothing_measured_means_no_estimate(model):
    _, photo, depth, mask = view(model, 1, False)
    frame = Frame(1, 0, INTRINSICS, 0.1, None, (), None)
    search, comparison = PoseSearch(model.mesh, model.diameter_mm), Comparison(model.mesh)
    assert estimate(mask, photo, np.zeros_like(depth), frame, search, comparison, model) is None
    assert len(measured_points(mask, depth, INTRINSICS, model.diameter_mm)) > 100
