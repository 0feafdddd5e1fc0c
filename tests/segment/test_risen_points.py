"""Masks that lack most of the object's own points are found again, led by these."""

import numpy as np
import pytest

from helpers.table_scene import FoundMasks, table_views
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.led_by_points import find_with_points
from zeroshop_steps.segment.mask_quality import MasksRejected
from zeroshop_steps.segment.motion_check import ObjectMoved
from zeroshop_steps.segment.risen_points import find_cluster

SUPPORT = SceneSupport(np.array([0.0, 0, 1]), 0.0, np.array([0.0, 0, 0.3]), 4.0, 600)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return table_views(tmp_path_factory.mktemp("ball"), [[(0.0, 0.0, 0.45)]] * 8)


@pytest.fixture(scope="module")
def cluster(scene):
    return find_cluster(scene[1], SUPPORT)


def whole_masks(cluster, views):
    return [odds > 0 for odds in cluster.weigh(views)]


def test_the_points_of_the_ball_are_one_cluster_and_those_of_the_table_are_not(scene, cluster):
    views, model = scene
    assert len(cluster.points) > 0.8 * 8 * 30 and cluster.points[:, 2].min() > 0.04
    flat = model.points[model.points[:, 2] < 0.01]
    assert find_cluster(type(model)(model.cameras, flat, np.zeros((len(flat), 3), np.uint8), np.full(len(flat), 3)), SUPPORT) is None


def test_a_floor_above_a_plane_that_was_guessed_too_low_is_no_thing(scene):
    _, model = scene
    floor = np.c_[np.random.default_rng(0).uniform(-1, 1, (400, 2)), np.full(400, 0.3)]
    assert find_cluster(type(model)(model.cameras, floor, np.zeros((400, 3), np.uint8), np.full(400, 3)), SUPPORT) is None


def test_they_speak_for_the_ball_and_against_what_is_far_from_it(scene, cluster):
    views, _ = scene
    for odds, view in zip(cluster.weigh(views), views, strict=True):
        camera = view.camera.resized(odds.shape[1], odds.shape[0])
        rows, columns, _, inside = camera.find_pixels(cluster.points)
        assert inside.all() and (odds[rows, columns] > 0).mean() > 0.9
        assert odds[0, 0] < 0 and odds[-1, -1] < 0


def test_masks_of_a_part_are_found_again(scene, cluster):
    views, _ = scene
    whole = whole_masks(cluster, views)
    part = [mask & (np.indices(mask.shape)[1] < np.flatnonzero(mask.any(0))[3]) for mask in whole]
    assert cluster.are_missed_by(part, views) and cluster.are_covered_by(whole, views)

    found, prior = find_with_points(views, scene[1], cluster, lambda odds: FoundMasks(part if odds is None else whole, {}))
    assert found.masks is whole and found.record == {"led_by_points": len(cluster.points)} and prior is not None


def test_masks_that_show_it_stay_and_so_do_those_that_points_do_not_mend(scene, cluster, capsys):
    views, _ = scene
    whole = whole_masks(cluster, views)
    part = [mask & (np.indices(mask.shape)[1] < np.flatnonzero(mask.any(0))[3]) for mask in whole]
    assert find_with_points(views, scene[1], cluster, lambda odds: FoundMasks(whole, {}))[1] is None
    assert "warning" not in capsys.readouterr().err
    found = find_with_points(views, scene[1], cluster, lambda odds: FoundMasks(part, {}))[0]
    assert found.masks is part and found.record["points_missed"] > 0.5
    assert "may show a part of the object only" in capsys.readouterr().err
    assert find_with_points(views, scene[1], None, lambda odds: FoundMasks(part, {}))[0].masks is part


def test_where_nothing_was_found_the_reason_stays(scene, cluster):
    def find(odds):
        raise StepError("the object moved during the film")

    with pytest.raises(StepError, match="moved"):
        find_with_points(*scene, cluster, find)


@pytest.mark.parametrize("balls_in", [[[(0.0, 0.0, 0.45)], [(0.0, 0.0, 0.3)]] * 4, [[(0.0, 0.0, 0.45)]] * 4 + [[(0.3, 0.1, 0.45)]] * 4])
def test_points_tie_the_views_of_one_thing_that_did_not_move_and_no_others(scene, cluster, tmp_path, balls_in):
    assert cluster.tie(scene[1]) and cluster.stay(scene[1])
    _, model = table_views(tmp_path, balls_in)
    found = find_cluster(model, SUPPORT)
    assert not found.tie(model) and not found.stay(model)


FRONT, BACK = [(0.0, 0.0, 0.45)], [(0.0, 0.0, 0.3)]


@pytest.fixture(scope="module")
def two_sides(tmp_path_factory):
    """A thing whose front and back have no point that the same views see; its front is seen at the beginning and at the end."""
    return table_views(tmp_path_factory.mktemp("sides"), [FRONT] * 2 + [BACK] * 3 + [FRONT] * 3)


def test_where_colours_say_that_it_moved_points_that_early_and_late_views_share_lead_the_masks(two_sides):
    views, model = two_sides
    cluster = find_cluster(model, SUPPORT)
    assert not cluster.tie(model) and cluster.stay(model)
    whole = whole_masks(cluster, views)

    def find(odds):
        if odds is None:
            raise ObjectMoved("the object moved during the film")
        return FoundMasks(whole, {"dropped": {}})

    found, _ = find_with_points(views, model, cluster, find)
    assert found.masks is whole and "moved" in found.record["without_points"]


@pytest.mark.parametrize(("dropped", "taken"), [(0, True), (2, False)])
def test_masks_that_contradict_each_other_are_replaced_where_nearly_all_led_by_points_agree(scene, cluster, dropped, taken):
    views, model = scene
    whole = whole_masks(cluster, views)

    def find(odds):
        if odds is None:
            raise MasksRejected("only 2 of 8 masks are good", [], set())
        return FoundMasks(whole, {"dropped": {str(index): "" for index in range(dropped)}})

    if not taken:
        with pytest.raises(MasksRejected, match="only 2 of 8"):
            find_with_points(views, model, cluster, find)
        return
    found, prior = find_with_points(views, model, cluster, find)
    assert found.masks is whole and prior is not None and "only 2 of 8" in found.record["without_points"]
