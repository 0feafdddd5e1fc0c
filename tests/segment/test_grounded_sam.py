"""A prompt finds the object: the box is chosen with sense, lost pictures are looked at again, and nothing found says what was seen."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.ball_scene import ball_cameras, ball_mask, write_ball_scene
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import compute_overlap
from zeroshop_steps.networks.grounding_dino import Box, choose_box
from zeroshop_steps.networks.sam2 import TrackedMask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.grounded_sam import ImageSequence, find_masks
from zeroshop_steps.segment.quality.mask_agreement import find_corners, render_common_hull

SIZE = (160, 120)
MIDDLE, CORNER, WHOLE = Box((60, 40, 100, 80), 0.5), Box((0, 0, 40, 30), 0.55), Box((1, 1, 159, 119), 0.9)


def test_the_box_is_chosen_by_score_and_centrality():
    assert choose_box([WHOLE, CORNER, MIDDLE], SIZE, 0.25) == MIDDLE
    assert choose_box([Box(CORNER.corners_px, 0.95), Box(MIDDLE.corners_px, 0.26)], SIZE, 0.25).corners_px == MIDDLE.corners_px
    assert choose_box([Box((70, 40, 110, 80), 0.9), MIDDLE], SIZE, 0.25).score == 0.9
    assert choose_box([WHOLE, Box(MIDDLE.corners_px, 0.2)], SIZE, 0.25) is None


def test_where_other_views_say_what_to_expect_agreement_counts():
    assert choose_box([MIDDLE, CORNER], SIZE, 0.25, expected_px=(2, 0, 44, 33)) == CORNER
    assert choose_box([MIDDLE], SIZE, 0.25, expected_px=(0, 0, 10, 10)) is None


def test_what_masks_have_in_common_is_found_in_spite_of_some_that_show_something_else():
    cameras = ball_cameras()
    masks = [ball_mask(camera) for camera in cameras]
    shown = [mask.copy() for mask in masks]
    for index in (1, 6, 9):
        shown[index] = ball_mask(cameras[index], (0.9, -0.5, 0.3), 0.3)
    shown[4][:] = False
    hulls = render_common_hull(cameras, shown)
    assert min(compute_overlap(hull, mask) for hull, mask in zip(hulls, masks, strict=True)) > 0.8
    assert not any(hull.any() for hull in render_common_hull(cameras, [np.zeros_like(mask) for mask in masks]))


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """The pictures of a ball and its true masks."""
    folder = tmp_path_factory.mktemp("ball")
    masks = write_ball_scene(folder)
    views, model = read_views(folder)
    return ImageSequence([view.image_path for view in views], SIZE, list(model.cameras)), masks


class Oracle:
    """Stands for both networks: boxes of the true masks, and masks that are lost in some pictures until these have a box of their own."""

    def __init__(self, masks, lost=(), wrong=None, unseen=(), blind=()):
        self.masks, self.lost, self.wrong, self.unseen, self.blind = masks, lost, wrong or {}, unseen, blind
        self.asked, self.followed = [], []

    def detect(self, image):
        red = (image[..., 0] > 150) & (image[..., 1] < 100)
        index = int(np.argmax([compute_overlap(red, mask) for mask in self.masks]))
        self.asked.append(index)
        if index in self.blind:
            return []
        if index in self.unseen:
            return [Box((0, 0, 12, 12), 0.4), Box((5, 5, 30, 20), 0.1)]
        return [Box((0, 0, 12, 12), 0.7), Box(find_corners(self.masks[index]), 0.6)]

    def follow(self, boxes):
        self.followed.append(sorted(boxes))
        found = []
        for index, mask in enumerate(self.masks):
            if index in self.lost and index not in boxes:
                mask = self.wrong.get(index, np.zeros_like(mask))
            found.append(TrackedMask(mask, 5.0 if mask.any() else -5.0))
        return found


def test_a_film_that_keeps_the_object_is_followed_from_its_first_picture(ball):
    pictures, masks = ball
    oracle = Oracle(masks)
    found, record = find_masks(pictures, oracle.detect, oracle.follow, "red ball.", 0.25)
    assert oracle.asked == [0] and oracle.followed == [[0]]
    assert min(compute_overlap(one, other) for one, other in zip(found, masks, strict=True)) > 0.97
    assert record["good_masks"] == 12 and record["lost_at_first"] == [] and list(record["boxes"]) == ["000000.png"]


@pytest.mark.slow
def test_pictures_in_which_it_was_lost_are_looked_at_again(ball):
    pictures, masks = ball
    elsewhere = ball_mask(pictures.cameras[7], (-0.8, 0.6, 0.2), 0.35)
    oracle = Oracle(masks, lost=(3, 7, 8), wrong={7: elsewhere})
    found, record = find_masks(pictures, oracle.detect, oracle.follow, "red ball.", 0.25)
    assert oracle.asked == [0, 3, 7, 8] and oracle.followed == [[0], [0, 3, 7, 8]]
    assert record["lost_at_first"] == ["000003.png", "000007.png", "000008.png"]
    assert record["good_masks"] == 12 and min(compute_overlap(one, other) for one, other in zip(found, masks, strict=True)) > 0.97


def test_a_picture_that_stays_lost_is_dropped(ball):
    pictures, masks = ball
    oracle = Oracle(masks, lost=(5,), unseen=(5,))
    _, record = find_masks(pictures, oracle.detect, oracle.follow, "red ball.", 0.25)
    assert record["dropped"] == {"000005.png": "the mask is empty"} and record["good_masks"] == 11


def test_masks_that_vanish_in_half_of_the_pictures_end_the_step(ball):
    pictures, masks = ball
    half = tuple(range(1, 12, 2))
    oracle = Oracle(masks, lost=half, unseen=half)
    with pytest.raises(StepError, match="only 6 of 12 masks are good, 8 are needed"):
        find_masks(pictures, oracle.detect, oracle.follow, "red ball.", 0.25)


def test_before_registration_lost_pictures_are_looked_at_again_too(ball):
    pictures, masks = ball
    oracle = Oracle(masks, lost=(2, 6), wrong={6: np.ones_like(masks[6])}, unseen=(2,))
    found, record = find_masks(replace(pictures, cameras=None), oracle.detect, oracle.follow, "red ball.", 0.25)
    assert oracle.followed == [[0], [0, 2, 6]] and record["lost_at_first"] == ["000002.png", "000006.png"]
    assert record["good_masks"] == 12 and record["median_disagreement"] is None
    assert np.array_equal(found[6], masks[6])


def test_the_object_may_be_missed_in_the_first_picture(ball):
    pictures, masks = ball
    oracle = Oracle(masks, blind=(0,))
    _, record = find_masks(pictures, oracle.detect, oracle.follow, "red ball.", 0.25)
    assert oracle.followed == [[2]] and record["good_masks"] == 12


def test_nothing_found_says_what_was_seen_and_what_to_try(ball):
    pictures, masks = ball
    with pytest.raises(StepError) as error:
        find_masks(pictures, lambda image: [WHOLE, Box((3.2, 4, 30, 20.6), 0.12)], Oracle(masks).follow, "blue cup.", 0.25)
    text = str(error.value)
    boxes = ["000000.png: x 1 to 159, y 1 to 119 (score 0.90), nearly the whole image; x 3 to 30, y 4 to 21 (score 0.12)", "000011.png"]
    for part in ('nothing was found that is "blue cup."', "column prompt", "support_plane", *boxes):
        assert part in text
