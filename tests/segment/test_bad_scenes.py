"""What a film may show that it should not, and what the user is told: nothing, two things, a thing that moved or that is gone."""

import numpy as np
import pytest

from helpers.table_scene import COUNT, table_views
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment import motion_check
from zeroshop_steps.segment.support_plane import find_masks

BALL = (0.0, 0.0, 0.5)


def told(folder, balls_in):
    """The error of a scene, or the record where there is none."""
    views, model = table_views(folder, balls_in)
    try:
        return find_masks(views, model, 240, seed=0)[1]
    except StepError as error:
        return str(error)


@pytest.mark.slow
def test_a_ball_on_a_table_is_found(tmp_path):
    record = told(tmp_path, [[BALL]] * COUNT)
    assert not isinstance(record, str), record
    assert record["good_masks"] == COUNT and record["median_disagreement"] < 0.05


def test_nothing_on_the_table(tmp_path):
    assert "nothing stands on the ground" in told(tmp_path, [[]] * COUNT)


@pytest.mark.slow
def test_two_things_beside_the_middle(tmp_path):
    assert "2 objects stand equally near" in told(tmp_path, [[(0.7, 0, 0.35), (-0.7, 0, 0.35)]] * COUNT)


@pytest.mark.slow
@pytest.mark.parametrize("to", [(0.3, 0.1, 0.5), (0.8, -0.5, 0.5)], ids=["a little", "far"])
def test_a_thing_that_moved_during_the_film(tmp_path, to):
    error = told(tmp_path, [[BALL]] * (COUNT // 2) + [[to]] * (COUNT // 2))
    assert isinstance(error, str) and "moved" in error, error


@pytest.mark.parametrize(("to", "moved"), [(BALL, False), ((0.3, 0.1, 0.5), True)], ids=["stays", "moves"])
def test_points_that_both_halves_see_say_that_a_thing_stayed(tmp_path, monkeypatch, to, moved):
    """Of a ball, one half of the views finds what is left of the middle, the other what is right of it."""
    views, model = table_views(tmp_path, [[BALL]] * (COUNT // 2) + [[to]] * (COUNT // 2))
    support, cells = SceneSupport(np.array([0.0, 0, 1]), 0.0, np.array([0.0, 0, 0.3]), 4.0, 600), range(-20, 21)
    footprints = iter([{(x, y) for x in cells for y in cells if x * side > 0} for side in (1, -1)])
    monkeypatch.setattr(motion_check, "select_object", lambda *_: None)
    monkeypatch.setattr(motion_check, "_find_footprint", lambda *_: next(footprints))
    given = (support, [view.camera for view in views], [np.zeros((1, 1))] * COUNT, model)
    if moved:
        with pytest.raises(StepError, match="the object moved during the film"):
            motion_check.check_not_moved(*given)
    else:
        motion_check.check_not_moved(*given)


@pytest.mark.slow
def test_a_thing_that_is_gone_in_half_of_the_photos(tmp_path):
    error = told(tmp_path, [[BALL] if index % 2 else [] for index in range(COUNT)])
    assert isinstance(error, str) and ("moved" in error or "masks are good" in error), error


@pytest.mark.slow
def test_photos_of_two_things_mixed(tmp_path):
    """A large and a small ball at the same place, in turn: neither is taken for both, and the photos that differ are named."""
    error = told(tmp_path, [[BALL] if index % 2 else [(0.0, 0.0, 0.3)] for index in range(COUNT)])
    assert isinstance(error, str) and "masks are good" in error and "contradicts the masks of the other views" in error, error
