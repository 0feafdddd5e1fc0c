"""A thing with print all over, on no table that could be told, is cut out by its own sparse points; views may cut it off."""

import numpy as np
import pytest

from helpers.camera_ring import ring_camera
from zeroshop_steps.geometry.cameras import SparseModel
from zeroshop_steps.geometry.images import write_image
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.point_silhouettes import draw_silhouette, drop_flat_columns, find_point_silhouettes, find_single_thing
from zeroshop_steps.segment.prior_maps import find_without_ground

COUNT, DISTANCE, RADIUS, SIZE_PX = 12, 2.5, 0.6, (160, 120)


def make_camera(index):
    """Of three views, two are nearer and look beside the ball's middle: it is cut off."""
    near = index % 3 > 0
    return ring_camera(index, COUNT, DISTANCE, (20.0, 35.0), (0.0, 0.0, 0.3 if near else 0.0), 260.0 if near else 130.0, SIZE_PX)


def draw_ball(camera):
    """(H, W) bool: the pixels whose rays meet the ball."""
    rows, columns = np.indices((camera.height_px, camera.width_px)) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(camera.intrinsics).T @ camera.camera_from_world[:3, :3]
    centre = camera.centre_in_world
    along = -(rays @ centre) / np.linalg.norm(rays, axis=-1)
    return centre @ centre - along**2 < RADIUS**2


@pytest.fixture
def scene(tmp_path):
    rng = np.random.default_rng(5)
    views, truth = [], []
    for index in range(COUNT):
        camera = make_camera(index)
        ball = draw_ball(camera)
        noise = rng.integers(-25, 25, (*ball.shape, 3))
        write_image(tmp_path / camera.name, (np.where(ball[..., None], [150, 110, 80], [90, 120, 140]) + noise).astype(np.uint8))
        views.append(View(camera, tmp_path / camera.name, None))
        truth.append(ball)
    ball = rng.normal(size=(900, 3))
    ball *= RADIUS / np.linalg.norm(ball, axis=1, keepdims=True)
    return views, ball, 8 * rng.normal(size=(200, 3)), truth


def make_model(views, points):
    return SparseModel(tuple(view.camera for view in views), points, np.zeros((len(points), 3), np.uint8), np.full(len(points), 4))


@pytest.mark.slow
def test_a_ball_in_a_room_is_cut_out_whole_or_cut_off(scene):
    views, ball, room, truth = scene
    masks, record = find_without_ground(find_point_silhouettes(views, make_model(views, np.concatenate([ball, room]))), views)
    assert record["good_masks"] == COUNT and len(record["cut_off"]) == 8
    overlaps = [(mask & true).sum() / (mask | true).sum() for mask, true in zip(masks, truth, strict=True)]
    assert min(overlaps) > 0.95


@pytest.mark.parametrize(("points", "reason"), [(0, "too few points"), (300, "no single thing")])
def test_a_few_points_or_those_of_several_things_tell_nothing(scene, points, reason):
    views, ball, _, _ = scene
    others = [ball[:points] * 0.3 + middle for middle in ([0.2, 0, 0], [-0.9, 0, 0], [0, 0.9, 0])]
    with pytest.raises(StepError, match=reason):
        find_point_silhouettes(views, make_model(views, np.concatenate(others)))


@pytest.mark.parametrize(("width", "whole"), [(0.3, True), (1.6, False)])
def test_a_tall_thing_is_one_but_not_all_of_a_room(width, whole):
    """A statue that fills the photos reaches as far as the points of a room do."""
    views = [View(ring_camera(index, COUNT, DISTANCE, (20.0, 35.0), (0, 0, 0), 130.0, SIZE_PX), None, None) for index in range(COUNT)]
    points = np.random.default_rng(2).uniform([-width, -width, -0.98], [width, width, 0.98], (12_000, 3))
    model = make_model(views, points)
    if whole:
        assert len(find_single_thing(model)[0]) > 0.9 * len(points)
    else:
        with pytest.raises(StepError, match="no single thing"):
            find_single_thing(model)


def test_points_beyond_the_border_close_the_silhouette_there(scene):
    camera, ball = make_camera(1), scene[1]
    drawn, true = draw_silhouette(ball, camera, 12.0), draw_ball(camera)
    assert (drawn & true).sum() / (drawn | true).sum() > 0.95
    assert (drawn == true)[:, [0, -1]].mean() > 0.9 and (drawn == true)[[0, -1]].mean() > 0.9


def test_labels_beside_the_thing_are_dropped(scene):
    ball, label = scene[1], np.random.default_rng(1).uniform([0.7, -0.3, -0.6], [1.2, 0.3, -0.55], (200, 3))
    kept = drop_flat_columns(np.concatenate([ball, label]), np.array([0.0, 0.0, 1.0]), 0.15)
    assert np.array_equal(kept, ball[np.isin(ball[:, 0], kept[:, 0])]) and len(kept) > 0.98 * len(ball)
