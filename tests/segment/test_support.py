"""Planes that the object may stand on, from sparse points, from the object's own points, and from what views show of the table."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.table_scene import table_views
from zeroshop_steps.geometry.cameras.pinhole import SparseModel
from zeroshop_steps.geometry.support.scene_support import find_focus, fit_level_planes, fit_scene_support
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.support import find_clusters, guess_supports, propose_supports

BALL = (0.0, 0.0, 0.45)


@pytest.fixture(scope="module")
def plain_scene(tmp_path_factory):
    return table_views(tmp_path_factory.mktemp("plain"), [[BALL]] * 12, plain=True)


def add_points(model, points):
    together = np.concatenate([model.points, points])
    return replace(
        model, points=together, colors=np.zeros((len(together), 3), np.uint8), track_lengths=np.full(len(together), 3), seen=None
    )


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


def test_a_plain_table_has_no_points_and_a_guess_serves(plain_scene):
    views, model = plain_scene
    with pytest.raises(StepError, match="no support plane"):
        fit_scene_support(model, views)
    [support] = guess_supports(model, views)
    assert support.normal @ [0, 0, 1] > np.cos(np.radians(1.0)) and abs(support.offset) < 0.06 * support.distance
    first, last = propose_supports(model, views, fit_level_planes(model, views))
    assert not first.fitted and first.support is not None and last.support is None


def test_a_plane_below_the_one_with_most_points_is_proposed_next(plain_scene):
    """Most points lie on the print of a plate. The table around it has fewer."""
    views, model = plain_scene
    rng = np.random.default_rng(0)
    plate = np.column_stack([rng.uniform(-1, 1, (1500, 2)), np.full(1500, 0.25)])
    table = rng.uniform(-2, 2, (900, 2))
    table = table[np.abs(table).max(axis=1) > 1.05]
    mixed = add_points(model, np.concatenate([plate, np.column_stack([table, np.zeros(len(table))])]))
    first, second, *_ = propose_supports(mixed, views, fit_level_planes(mixed, views))
    assert first.fitted and abs(first.support.offset - 0.25) < 0.01
    assert second.fitted and abs(second.support.offset) < 0.01


def test_the_flat_top_of_the_object_is_no_support(plain_scene):
    """All points lie on a small lid in the middle: what the object stands on reaches farther."""
    views, model = plain_scene
    rng = np.random.default_rng(0)
    lid = np.column_stack([rng.uniform(-0.4, 0.4, (300, 2)), np.full(300, 0.3)])
    with pytest.raises(StepError, match="no support plane"):
        fit_scene_support(SparseModel(model.cameras, lid, np.zeros((300, 3), np.uint8), np.full(300, 3)), views)


def test_dense_points_are_clusters_and_lonely_ones_are_not():
    rng = np.random.default_rng(0)
    one, other = rng.normal(0, 0.05, (60, 3)), rng.normal(0, 0.05, (40, 3)) + [1.0, 0, 0]
    lonely = rng.uniform(-3, 3, (30, 3)) + [0, 0, 10]
    clusters = find_clusters(np.concatenate([one, other, lonely]), 0.1)
    assert sorted(map(len, clusters)) == pytest.approx([40, 60], abs=4)
    assert find_clusters(one[:5], 0.1) == []
