"""The object is found without any weights: its plane, itself, and its outline."""

from dataclasses import replace

import numpy as np
import pytest

from zeroshop_steps.geometry.cameras import SparseModel
from zeroshop_steps.geometry.scene_support import find_focus, fit_scene_support
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.support_plane import find_masks
from zeroshop_steps.segment.tidy_mask import tidy_mask


def overlap(one, other):
    return (one & other).sum() / (one | other).sum()


def test_the_plane_is_found(carton_scene):
    views, model = carton_scene
    support = fit_scene_support(model, views)
    assert support.normal @ [0, 0, 1] > np.cos(np.radians(0.3))
    lowest = model.points[:, 2].min()
    assert abs(support.heights(np.array([[0, 0, lowest]]))[0]) < 0.01 * support.distance
    assert np.linalg.norm(np.cross(support.axes()[0], support.axes()[1]) - support.normal) < 1e-9


def test_a_lid_is_no_ground(carton_scene):
    """Most points on the lid, few on the ground: what lies below a plane near the focus speaks against it."""
    views, model = carton_scene
    height = fit_scene_support(model, views).heights(model.points)
    top = np.quantile(height[height > 2], 0.5) if (height > 2).any() else 10.0
    rng = np.random.default_rng(1)
    lid = np.column_stack([rng.uniform(-30, 30, (600, 2)), np.full(600, model.points[:, 2].min() + top)])
    sides = np.column_stack([rng.uniform(-30, 30, (500, 2)), rng.uniform(0, 0.9 * top, 500) + model.points[:, 2].min()])
    support = fit_scene_support(replace(model, points=np.concatenate([model.points[::2], lid, sides])), views)
    assert abs(support.heights(lid)).min() > 0.5 * top


def test_no_ground_is_an_error(carton_scene):
    views, model = carton_scene
    with pytest.raises(StepError, match="no support plane"):
        fit_scene_support(SparseModel(model.cameras, model.points[:20], model.colors[:20], model.track_lengths[:20]), views)


def test_cameras_that_look_apart_have_no_focus(carton_scene):
    turned = [
        replace(camera, camera_from_world=np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.camera_from_world) for camera in carton_scene[1].cameras
    ]
    with pytest.raises(StepError, match="look away"):
        find_focus(turned)


@pytest.mark.slow
def test_masks_match_the_true_ones(carton_scene):
    views, model = carton_scene
    masks, record = find_masks(views, model, 240, seed=0)
    overlaps = [overlap(mask, view.mask()) for mask, view in zip(masks, views, strict=True)]
    assert np.median(overlaps) > 0.93 and min(overlaps) > 0.8
    assert record["good_masks"] >= 18 and set(record["masks"]) == {view.camera.name for view in views}
    assert not record["cut_off"]


@pytest.mark.slow
def test_an_empty_ground_is_an_error(carton_scene, monkeypatch):
    """The picture of the bare ground in every view: nothing differs from it."""
    from zeroshop_steps.segment import ground

    views, model = carton_scene
    monkeypatch.setattr(ground.GroundPicture, "evidence", lambda self, camera, image, *_: np.full(image.shape[:2], -1.0, np.float32))
    with pytest.raises(StepError, match="nothing stands on the ground"):
        find_masks(views, model, 120, seed=0)


def test_islands_and_pinholes_go():
    mask = np.zeros((60, 80), np.float32)
    mask[10:50, 10:50] = 1.0
    hull = mask > 0.5
    mask[20:22, 20:22] = 0.0  # a pinhole
    mask[30:50, 65:80] = 1.0  # an island off the hull
    assert np.array_equal(tidy_mask(mask, hull) > 0.5, hull)
    handle = hull.copy()
    handle[30:40, 30:40] = False  # a hole that the hull has, too
    mask[30:40, 30:40] = 0.0
    assert np.array_equal(tidy_mask(mask, handle) > 0.5, handle)
