"""A leaflet that lies on a plain table is told from the object by its print."""

import numpy as np
import pytest

from helpers.table_scene import ball_mask, look_along, table_views
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.segment.flat_print import find_flat_print
from zeroshop_steps.segment.support_plane import find_masks
from zeroshop_steps.segment.windows import cut_views, take_whole

BALL, VIEWS = (0.0, 0.0, 0.35), 12
LEAFLET = (0.7, 0.0, 0.5)  # x and y of its middle, half its side


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The plane, cameras and images."""
    views = table_views(tmp_path_factory.mktemp("views"), [[BALL]] * VIEWS, plain=True, leaflet=LEAFLET)[0]
    support = SceneSupport(np.array([0.0, 0.0, 1.0]), 0.0, np.array([0.0, 0.0, 0.3]), 4.0, 0)
    return support, *cut_views(views, take_whole(views), 240)


def find_leaflet(camera, margin=-0.05):
    """(H, W) bool: the pixels well within the leaflet, or up to a margin around it, the ball in front of it or not."""
    rays = look_along(camera)
    ground = camera.centre_in_world - camera.centre_in_world[2] / rays[..., 2:] * rays
    return np.abs(ground[..., :2] - LEAFLET[:2]).max(-1) < LEAFLET[2] + margin


def find_print(scene, risen):
    support, cameras, images = scene
    return find_flat_print(support, cameras, images, risen).find(cameras, images)


def test_the_leaflet_is_found_and_the_ball_before_it_is_not(scene):
    found = {True: [], False: []}
    for camera, printed in zip(scene[1], find_print(scene, np.zeros((0, 3))), strict=True):
        ball, leaflet = ball_mask(camera, BALL), find_leaflet(camera)
        for on_ball in found:
            found[on_ball].extend(printed[leaflet & (ball == on_ball)])
        # Beyond the ball's soft shadow, which lies flat, too.
        assert printed[~find_leaflet(camera, 0.6)].mean() < 0.01
    assert len(found[True]) > 500 and np.mean(found[True]) < 0.05
    assert np.mean(found[False]) > 0.85


def test_nothing_is_told_below_points_that_rise(scene):
    y, x = np.mgrid[-0.5:0.5:0.05, 0.2:1.2:0.05]
    risen = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.2)])
    assert not any(printed[find_leaflet(camera)].any() for camera, printed in zip(scene[1], find_print(scene, risen), strict=True))


@pytest.mark.slow
def test_masks_are_without_the_leaflet_and_the_user_is_told(tmp_path, capsys):
    views, model = table_views(tmp_path, [[BALL]] * 8, plain=True, leaflet=(0.45, 0.0, 0.22))
    masks, record = find_masks(views, model, 160, seed=0)
    truths = [ball_mask(view.camera, BALL) for view in views]
    overlaps = [(mask & truth).sum() / (mask | truth).sum() for mask, truth in zip(masks, truths, strict=True)]
    assert np.median(overlaps) > 0.9 and min(overlaps) > 0.8
    assert record["flat_print"] > 0.1
    assert "print that lies flat on the table, such as a leaflet, is left out" in capsys.readouterr().err
