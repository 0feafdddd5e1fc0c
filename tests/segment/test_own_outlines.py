"""Masks that all lack the same part agree with each other, but each photo alone shows where the object ends."""

import numba
import numpy as np
import pytest

from helpers.table_scene import FoundMasks, ball_mask, table_views
from zeroshop_steps.geometry.cameras import Camera
from zeroshop_steps.geometry.images import compute_overlap, write_image
from zeroshop_steps.geometry.registered_views import View
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.segment.own_outlines import OUTGROWN_SHARE, cut_around, find_whole

BALL = (0.0, 0.0, 0.45)


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    return table_views(tmp_path_factory.mktemp("ball"), [[BALL]] * 8, plain=True)[0]


@pytest.fixture(scope="module")
def whole(views):
    return [ball_mask(view.camera, BALL) for view in views]


@pytest.fixture(scope="module")
def bitten(whole):
    """Without the upper sixth: seen from around, that is one cap of the ball."""
    return [mask & (np.arange(len(mask))[:, None] > np.quantile(np.flatnonzero(mask.any(1)), 0.17)) for mask in whole]


def test_photos_add_what_masks_lack_and_hardly_anything_to_whole_ones(views, whole, bitten):
    maps, growth = cut_around(views, bitten)
    lacking = np.median([one.sum() / other.sum() for one, other in zip(whole, bitten, strict=True)]) - 1
    assert OUTGROWN_SHARE < growth < 1.2 * lacking
    assert np.median([compute_overlap(found > 0.5, mask) for found, mask in zip(maps, whole, strict=True)]) > 0.93
    assert cut_around(views, whole)[1] < OUTGROWN_SHARE / 2


def test_photos_are_cut_alike_in_one_thread_and_in_two(views, bitten):
    alone, growth = cut_around(views, bitten)
    numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
    beside, growth_beside = cut_around(views, bitten)
    assert growth == growth_beside
    np.testing.assert_array_equal(alone, beside)


def test_whole_masks_stay_as_they_are(views, whole):
    found = FoundMasks(whole, {"dropped": {}})
    assert find_whole(views, found, None, lambda odds: pytest.fail("they are whole")) == (found, None)


def test_masks_that_lack_a_part_are_found_again(views, whole, bitten):
    asked = []

    def find(odds):
        asked.append(odds)
        return FoundMasks(whole, {"dropped": {}})

    found, prior = find_whole(views, FoundMasks(bitten, {"dropped": {}, "led_by_points": 300}), None, find)
    assert found.masks is whole and prior is asked[0]
    assert found.record["led_by_own_outlines"] > OUTGROWN_SHARE and found.record["led_by_points"] == 300
    lacked = [mask & ~part for mask, part in zip(whole, bitten, strict=True)]
    assert np.median([odds[part].mean() for odds, part in zip(prior, lacked, strict=True)]) > 1


@pytest.mark.parametrize("reason", ["refused", "bad", "still lacking"])
def test_what_does_not_mend_them_is_not_taken(views, whole, bitten, reason, capsys):
    def find(odds):
        if reason == "refused":
            raise StepError("only 2 of 8 masks are good")
        return FoundMasks(bitten, {"dropped": {}}) if reason == "still lacking" else FoundMasks(whole, {"dropped": dict.fromkeys("ab")})

    before = [np.ones((3, 3))] * 8
    found, prior = find_whole(views, FoundMasks(bitten, {"dropped": {}}), before, find)
    assert found.masks is bitten and prior is before and found.record["outgrown"] > OUTGROWN_SHARE
    assert "may lack a part of the object" in capsys.readouterr().err


def test_what_goes_on_to_the_end_of_the_band_is_no_part(tmp_path):
    for index in range(3):
        image = np.full((90, 120, 3), 90, np.uint8)
        image[:, 50:] = 210  # a wall of the object's colour, which stands before it
        image[30:60, 30:60] = 210
        write_image(tmp_path / f"{index}.png", image)
    cameras = [Camera(f"{index}.png", 120, 90, np.diag([100.0, 100, 1]), np.eye(4)) for index in range(3)]
    photos = [View(camera, tmp_path / camera.name, None) for camera in cameras]
    mask = np.zeros((90, 120), bool)
    mask[30:60, 35:60] = True
    maps, growth = cut_around(photos, [mask] * 3)
    assert growth == pytest.approx(5 / 25, abs=0.05)
    assert maps[0][32:58, 31:59].all() and not maps[0][:, 64:].any()
