"""Structure tells an object from a printed ground where colours agree."""

import cv2
import numpy as np
import pytest

from zeroshop_steps.segment.ground_structure import SHIFT_PX, WINDOW_PX, find_other_structure, find_risen_plain, measure_print

SIZE_PX, BLOCK = 90, slice(30, 60)
INSIDE = slice(30 + WINDOW_PX, 60 - WINDOW_PX)


def draw_print(seed):
    """(H, W, 3) float32: mottled grey."""
    grey = np.random.default_rng(seed).uniform(0, 255, (SIZE_PX // 2, SIZE_PX // 2)).astype(np.float32)
    return cv2.resize(grey, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_LINEAR)[..., None].repeat(3, axis=2)


def test_another_print_of_the_same_greys_is_other_structure():
    ground = draw_print(0)
    image = ground.copy()
    image[BLOCK, BLOCK] = draw_print(1)[BLOCK, BLOCK]
    other = find_other_structure(image, ground)
    assert np.median(other[INSIDE, INSIDE]) == 1.0  # some patches look alike by chance
    other[30 - WINDOW_PX : 60 + WINDOW_PX, 30 - WINDOW_PX : 60 + WINDOW_PX] = 0.0
    assert other.max() == 0.0


@pytest.mark.parametrize("change", [lambda image: 0.5 * image, lambda image: np.roll(image, SHIFT_PX, axis=0), lambda image: image])
def test_a_shadow_and_small_errors_of_the_camera_change_no_structure(change):
    ground = draw_print(0)
    assert find_other_structure(change(ground), ground)[5:-5, 5:-5].max() == 0.0


def test_plain_patches_show_no_structure():
    rng = np.random.default_rng(2)
    one, other = (120 + rng.normal(scale=2.0, size=(SIZE_PX, SIZE_PX, 3)).astype(np.float32) for _ in range(2))
    assert find_other_structure(one, other).max() == 0.0


def test_a_plain_thing_on_print_shows_no_structure():
    """Its colour tells it. And a plain sheet may be the ground, where the picture of it shows in part what stands on it."""
    ground = draw_print(0)
    image = ground.copy()
    image[BLOCK, BLOCK] = 127.0
    assert find_other_structure(image, ground)[INSIDE, INSIDE].max() == 0.0


def test_print_is_what_the_views_share():
    known = np.ones((SIZE_PX, SIZE_PX), bool)
    shared = np.stack([draw_print(0)] * 5)
    shared[1, :20] = np.nan
    assert measure_print(draw_print(0), known, shared) == 1.0
    assert measure_print(draw_print(0), known, np.stack([draw_print(seed) for seed in range(5, 10)])) == 0.0
    plain = 120 + np.random.default_rng(2).normal(scale=2.0, size=(5, SIZE_PX, SIZE_PX, 3)).astype(np.float32)
    assert measure_print(np.full((SIZE_PX, SIZE_PX, 3), 120, np.float32), known, plain) == 0.0
    assert measure_print(draw_print(0), ~known, shared) == 0.0


@pytest.mark.parametrize(("around", "risen"), [((150.0, 50.0, 40.0), True), ((60.0, 90.0, 200.0), False), (None, False)])
def test_a_plain_place_in_print_is_no_ground_where_what_rises_has_its_hue(around, risen):
    """The floor of a red bowl is, a red sheet below a blue thing is not, and one below nothing is not."""
    picture = draw_print(0)
    picture[20:70, 20:70] = (180.0, 60.0, 48.0)
    picture[2:14, 2:14] = 100.0  # shapes of a print are small
    samples = np.stack([picture] * 9)
    if around:
        for sample in samples[:4]:
            sample[10:88, 60:88] = sample[60:88, 10:60] = around
    found = find_risen_plain(picture, np.ones((SIZE_PX, SIZE_PX), bool), samples)
    assert found[35:55, 35:55].all() == risen and found.any() == risen and not found[:15, :15].any()
