"""The object is found without a network on printed and plain tables; what a film should not show is refused with a reason that is true."""

import numpy as np
import pytest

from helpers.table_scene import COUNT, ball_mask, table_views
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.finder import find_all_on, find_masks
from zeroshop_steps.segment.list_objects import SHOWN_WIDTH_PX, describe_objects, draw_objects
from zeroshop_steps.segment.objects import NothingFound
from zeroshop_steps.segment.photometry.exposure import Exposure
from zeroshop_steps.segment.quality.mask_scores import REASONS
from zeroshop_steps.segment.scene import read_mask_scene
from zeroshop_steps.segment.support import propose_supports

BALL = (0.0, 0.0, 0.5)
FEW = 8
"""Views of a printed table, where it is not asked whether something moved: time grows with them."""


def find(views, model, saliency=None, place=None):
    exposure = Exposure(np.zeros((len(views), 3)), False, [])
    return find_masks(views, model, exposure, saliency, None, 240, place=place)


def tell(folder, balls_in, plain=False):
    """The error of a scene, or the record where there is none."""
    try:
        return find(*table_views(folder, balls_in, plain=plain))[1]
    except StepError as error:
        return str(error)


@pytest.mark.slow
@pytest.mark.parametrize("plain", [False, True], ids=["printed", "plain"])
def test_a_ball_on_a_table_is_found(tmp_path, plain):
    """The plane of the plain table lies where the shadow lies. Without a network, a little of the shadow's dark foot comes along there."""
    count = COUNT if plain else FEW
    views, model = table_views(tmp_path, [[BALL]] * count, plain=plain)
    masks, record = find(views, model)
    overlaps = [compute_overlap(mask, ball_mask(view.camera, BALL)) for mask, view in zip(masks, views, strict=True)]
    assert np.median(overlaps) > (0.87 if plain else 0.93) and min(overlaps) > 0.85
    assert record["good_masks"] == count and record["median_disagreement"] < 0.05 and record["objects"] == 1
    assert record["plane_from"] == ("views" if plain else "points") and abs(record["plane"]["offset"]) < 0.05
    assert record["probability"] > 0.5 and not record["cut_off"]


@pytest.mark.slow
def test_of_two_things_the_one_in_the_middle_is_taken(tmp_path):
    views, model = table_views(tmp_path, [[(0.1, 0.0, 0.4), (1.2, 0.9, 0.4)]] * FEW)
    masks, record = find(views, model)
    truths = [ball_mask(view.camera, (0.1, 0.0, 0.4)) for view in views]
    assert np.median([compute_overlap(mask, truth) for mask, truth in zip(masks, truths, strict=True)]) > 0.85
    assert record["objects"] >= 2


@pytest.mark.slow
def test_each_of_several_objects_can_be_meant(tmp_path):
    """All are listed, and each is found again by its place, in other numbers' order, too; a place without one is an error."""
    balls = [(1.0, 0.0, 0.3), (-1.0, 0.0, 0.3)]
    views, model = table_views(tmp_path, [balls] * COUNT)
    scene = read_mask_scene(views, model, Exposure(np.zeros((COUNT, 3)), False, []), None, 240)
    found = find_all_on(scene, next(propose_supports(model, views, scene.planes)))[1]
    listed = describe_objects(scene, found)
    assert len(listed) == 2 and draw_objects(scene, found).shape[1] == 3 * SHOWN_WIDTH_PX
    for ball in balls:
        nearest = min(listed, key=lambda one: np.linalg.norm(one.center[:2] - ball[:2]))
        assert np.linalg.norm(nearest.center[:2] - ball[:2]) < 0.2 and nearest.cut_off < 0.01
        masks, _ = find(views, model, place=nearest.center)
        overlaps = [compute_overlap(mask, ball_mask(view.camera, ball)) for mask, view in zip(masks, views, strict=True)]
        assert np.median(overlaps) > 0.95
    with pytest.raises(NothingFound, match="not found again"):
        find(views, model, place=np.array([0.0, 1.2, 0.4]))


@pytest.mark.slow
def test_what_a_network_sees_finds_what_has_the_tables_color(tmp_path):
    """A network that sees the ball in all photos but two, where it sees another thing."""
    views, model = table_views(tmp_path, [[BALL]] * COUNT, plain=True)
    truths = [ball_mask(view.camera, BALL) for view in views]
    saliency = [truth.astype(np.float32) for truth in truths]
    for index in (2, 7):
        saliency[index] = ball_mask(views[index].camera, (1.0, 0.6, 0.3)).astype(np.float32)
    masks, _ = find(views, model, saliency)
    overlaps = [compute_overlap(mask, truth) for mask, truth in zip(masks, truths, strict=True)]
    assert np.median(overlaps) > 0.95 and min(overlaps) > 0.8


def test_nothing_on_the_table(tmp_path):
    assert "no object was found" in tell(tmp_path, [[]] * FEW)


@pytest.mark.slow
def test_two_things_beside_the_middle(tmp_path):
    assert "two objects are equally near" in tell(tmp_path, [[(0.7, 0, 0.35), (-0.7, 0, 0.35)]] * FEW)


@pytest.mark.slow
@pytest.mark.parametrize("to", [(0.6, 0.3, 0.5), (0.8, -0.5, 0.5)], ids=["a little", "far"])
def test_a_thing_that_moved_during_the_film(tmp_path, to):
    error = tell(tmp_path, [[BALL]] * (COUNT // 2) + [[to]] * (COUNT // 2))
    assert isinstance(error, str) and "moved" in error, error


@pytest.mark.slow
def test_a_thing_that_is_gone_in_half_of_the_photos(tmp_path):
    error = tell(tmp_path, [[BALL] if index % 2 else [] for index in range(COUNT)])
    assert isinstance(error, str) and ("no object was found" in error or any(reason in error for reason in REASONS.values())), error


@pytest.mark.slow
def test_photos_of_two_things_mixed(tmp_path):
    """A large and a small ball at the same place, in turn: neither is taken for both."""
    error = tell(tmp_path, [[BALL] if index % 2 else [(0.0, 0.0, 0.25)] for index in range(COUNT)])
    assert isinstance(error, str) and any(reason in error for reason in REASONS.values()), error
