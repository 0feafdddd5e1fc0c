"""Crops of rendering and photo show the same where the pose is right; updates and starts are what the networks know."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from helpers.printed_box import INTRINSICS, make_box, view
from zeroshop_steps.bop.formats.symmetry import list_symmetry_transforms
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.networks.foundationpose.settings import CROP_PX, LARGEST_TURN_RAD
from zeroshop_steps.pose.foundationpose.crops import FOR_REFINER, FOR_SCORER, PLAIN, DrawnModel, Observation, cut_pairs
from zeroshop_steps.pose.foundationpose.estimator import apply_update, estimate_centre, filter_depth, make_rotations

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def seen():
    """(pose, photo with depth, model) of a box whose depth has no noise."""
    box = make_box()
    pose, photo, depth, _ = view(box, 1, False)
    model = DrawnModel.of(box.mesh, np.zeros(3), box.diameter_mm, CPU)
    return torch.as_tensor(pose, dtype=torch.float32)[None], Observation.of(photo, depth, INTRINSICS, CPU), model


def likeness(pairs) -> float:
    """Correlation of the colours where both crops show something."""
    both = (pairs.rendered[:, 3:] != 0).all(1) & (pairs.observed[:, 3:] != 0).all(1)
    colors = [image[:, :3].permute(0, 2, 3, 1)[both].ravel() for image in (pairs.rendered, pairs.observed)]
    return float(np.corrcoef(*colors)[0, 1])


@pytest.mark.parametrize("style", [FOR_REFINER, FOR_SCORER])
def test_at_the_true_pose_both_crops_show_the_same(seen, style):
    pose, photo, model = seen
    pairs = cut_pairs(photo, model, pose, style)
    both = (pairs.rendered[:, 3:] != 0).all(1) & (pairs.observed[:, 3:] != 0).all(1)
    drawn = (pairs.rendered[:, 3:] != 0).any(1)
    assert both.sum() > 0.9 * drawn.sum() > 0.1 * CROP_PX**2
    apart = ((pairs.rendered - pairs.observed)[:, 3:].abs().amax(1))[both]
    assert apart.median() * model.diameter_mm / 2 < 2.0, "about a pixel's width, which is 1.4 mm there"
    turned = pose.clone()
    turned[:, :3, :3] = pose[:, :3, :3] @ torch.diag(torch.tensor([-1.0, -1.0, 1.0]))
    flipped = cut_pairs(photo, model, turned, style)
    assert likeness(pairs) > likeness(flipped) + 0.2, "the shape is the same, the print is not"


def test_geometry_stays_in_single_precision_where_networks_run_in_half(seen):
    pose, photo, model = seen
    turn, nothing = torch.tensor([[0.2, -0.1, 0.3]]), torch.zeros(1, 3)
    exact = cut_pairs(photo, model, pose, FOR_REFINER), apply_update(pose, nothing, turn, 100.0)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        pairs, moved = cut_pairs(photo, model, pose, FOR_REFINER), apply_update(pose, nothing, turn, 100.0)
    torch.testing.assert_close(pairs.rendered, exact[0].rendered, rtol=0, atol=0)
    torch.testing.assert_close(moved, exact[1], rtol=0, atol=0)


def test_a_pose_that_is_moved_in_depth_shows_it(seen):
    pose, photo, model = seen
    farther = pose.clone()
    farther[:, 2, 3] += 20.0
    pairs = cut_pairs(photo, model, farther, FOR_REFINER)
    both = (pairs.rendered[:, 3:] != 0).all(1) & (pairs.observed[:, 3:] != 0).all(1)
    nearer = (pairs.rendered - pairs.observed)[:, 5][both].median() * model.diameter_mm / 2
    assert abs(float(nearer) - 20.0) < 3.0


def test_a_model_without_texture_is_grey_and_lit_from_the_camera(seen):
    pose, photo, _ = seen
    box = make_box()
    plain = DrawnModel.of(Mesh(box.mesh.vertices, box.mesh.faces, box.mesh.normals), np.zeros(3), box.diameter_mm, CPU)
    colors = cut_pairs(photo, plain, pose, FOR_REFINER).rendered[:, :3]
    lit = colors[colors > 0]
    assert 0.8 * PLAIN - 1e-5 <= lit.min() < lit.max() <= 1.3 * PLAIN + 1e-5


def test_updates_turn_the_model_about_its_centre_against_the_axis_and_by_twenty_degrees_at_most():
    pose = torch.eye(4)[None].repeat(2, 1, 1)
    pose[:, :3, 3] = torch.tensor([10.0, 20.0, 700.0])
    turn = torch.tensor([[0.0, 0.0, 0.5], [100.0, 0.0, 0.0]])
    moved = apply_update(pose, torch.tensor([[0.1, 0.0, -0.2], [0.0, 0.0, 0.0]]), turn, 200.0)
    torch.testing.assert_close(moved[0, :3, 3], torch.tensor([20.0, 20.0, 680.0]))
    turned = Rotation.from_matrix(moved[:, :3, :3].numpy()).as_rotvec()
    np.testing.assert_allclose(turned, [[0, 0, -LARGEST_TURN_RAD * np.tanh(0.5)], [-LARGEST_TURN_RAD, 0, 0]], atol=1e-6)


def test_hypotheses_look_from_everywhere_and_symmetries_make_fewer_of_them():
    every = make_rotations(np.eye(4)[None])
    assert len(every) == 252
    others = Rotation.random(200, random_state=0).as_matrix()
    nearest = np.degrees(np.arccos(np.clip((np.einsum("aij,bij->ab", others, every).max(1) - 1) / 2, -1, 1)))
    assert nearest.max() < 40.0, "two refinements of 20 degrees reach any rotation"
    axis = list_symmetry_transforms({"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]})
    turning = make_rotations(axis)
    assert 15 < len(turning) < 60
    alike = np.einsum("aij,sjk->asik", others, axis[::9, :3, :3])
    away = np.degrees(np.arccos(np.clip((np.einsum("asij,bij->asb", alike, turning).max((1, 2)) - 1) / 2, -1, 1)))
    assert away.max() < 45.0


def test_the_centre_is_guessed_from_box_and_median_depth():
    mask, depth = np.zeros((60, 80), bool), np.zeros((60, 80), np.float32)
    mask[10:21, 30:41], depth[10:21, 30:36] = True, 500.0
    found = estimate_centre(mask, depth, np.array([[100.0, 0, 40], [0, 100, 30], [0, 0, 1]]))
    np.testing.assert_allclose(found, [-25.0, -75.0, 500.0])
    assert estimate_centre(np.zeros_like(mask), depth, INTRINSICS) is None and estimate_centre(mask, 0 * depth, INTRINSICS) is None


def test_depth_is_cut_and_smoothed_and_lonely_values_are_dropped():
    depth = np.full((20, 20), 700.0, np.float32)
    depth[:, 10:] = 2000.0
    depth[5, 5], depth[8, 3] = 900.0, 0.0
    found = filter_depth(depth, 1500.0)
    assert (found[:, 12:] == 0).all(), "farther than the cut"
    assert abs(found[8, 3] - 700) < 1 and abs(found[5, 5] - 700) < 1, "filled from its neighbours"
    assert np.abs(found[:, :9] - 700).max() < 1
