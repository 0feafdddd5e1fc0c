"""A sheet on which the object stands is no part of it, though its colour is not the table's."""

import itertools

import cv2
import numpy as np
import pytest

from helpers.table_scene import ball_mask, table_views
from zeroshop_steps.geometry.scene_support import SceneSupport
from zeroshop_steps.segment import flat_things
from zeroshop_steps.segment.flat_things import find_beside_flat, find_flat_foot
from zeroshop_steps.segment.led_by_points import Found
from zeroshop_steps.segment.support_plane import find_masks

BALL, VIEWS = (0.0, 0.0, 0.35), 8


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    return table_views(tmp_path_factory.mktemp("views"), [[BALL]] * VIEWS, plain=True)[0]


def see_boxes(views, *boxes):
    """Masks of upright boxes: half their width, and from which height to which."""
    masks = []
    for view in views:
        mask = np.zeros((view.camera.height_px, view.camera.width_px), np.uint8)
        for half, low, high in boxes:
            corners = np.array(list(itertools.product((-half, half), (-half, half), (low, high))))
            outline = cv2.convexHull(np.rint(view.camera.project(corners)[0] - 0.5).astype(np.int32))
            cv2.fillConvexPoly(mask, outline, 1)
        masks.append(mask > 0)
    return masks


@pytest.mark.parametrize(
    ("boxes", "flat"),
    [
        ([(0.9, 0.0, 0.005)], True),
        ([(0.9, 0.0, 0.005), (0.2, 0.0, 0.5)], True),
        ([(0.9, 0.0, 0.2)], False),
        ([(0.4, 0.0, 0.7)], False),
        ([(0.2, 0.3, 0.7)], False),
    ],
    ids=["sheet", "box on a sheet", "low box", "box", "nothing on the ground"],
)
def test_what_rises_hides_the_ground_behind_it(views, boxes, flat):
    support = SceneSupport(np.array([0.0, 0.0, 1.0]), 0.0, np.array([0.0, 0.0, 0.3]), 4.0, 0)
    assert (find_flat_foot(views, see_boxes(views, *boxes), support) is not None) == flat


@pytest.mark.parametrize(
    ("place_by_place", "by_color", "chosen"),
    [
        ((0.0, 0.06, 0), (0.0, 0.01, 0), True),
        ((0.0, 0.01, 0), (0.0, 0.06, 0), False),
        ((0.0, 0.06, 0), (0.2, 0.01, 0), False),
        ((0.2, 0.01, 0), (0.0, 0.06, 0), True),
        ((0.2, 0.01, 0), (0.2, 0.06, 0), True),
        ((0.0, 0.06, 0), (0.0, 0.01, 4), False),
    ],
    ids=["shadows", "agreement", "a side has the sheet's colour", "low and of one colour", "both lack a part", "few masks are left"],
)
def test_masks_that_agree_best_are_taken_unless_photos_go_on_beyond_them(views, monkeypatch, place_by_place, by_color, chosen):
    support = SceneSupport(np.array([0.0, 0.0, 1.0]), 0.0, np.array([0.0, 0.0, 0.3]), 4.0, 0)
    record = {"plane_from": "points", "plane_inliers": 0}

    def find_on(_, __, told_by_color, ___):
        growth, disagreement, dropped = by_color if told_by_color else place_by_place
        found = {"median_disagreement": disagreement, "dropped": {str(number): "" for number in range(dropped)}}
        masks = list(box)
        growths[id(masks)] = growth
        return Found(masks, found, support, True, np.zeros(3), None), None

    sheet, box = see_boxes(views, (0.9, 0.0, 0.005)), see_boxes(views, (0.4, 0.0, 0.7))
    growths = {}
    monkeypatch.setattr(flat_things, "cut_around", lambda _, masks: ([], growths[id(masks)]))
    found = find_beside_flat(views, Found(sheet, record, support, True, np.zeros(3), None), find_on)
    assert found is not None and found[2] == chosen


@pytest.mark.slow
def test_a_white_sheet_on_a_brown_table_is_left_out_and_the_user_told(tmp_path, capsys):
    views, model = table_views(tmp_path, [[BALL]] * VIEWS, plain=True, sheet=0.8)
    masks, _ = find_masks(views, model, 240, seed=0)
    truths = [ball_mask(view.camera, BALL) for view in views]
    overlaps = [(mask & truth).sum() / (mask | truth).sum() for mask, truth in zip(masks, truths, strict=True)]
    assert np.median(overlaps) > 0.85 and min(overlaps) > 0.8
    assert "lies flat under the object, such as a sheet of paper, is left out" in capsys.readouterr().err
