"""The tool that registers subsets of views: what it draws, what it keeps, and how it judges."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from helpers.camera_ring import ring_camera
from helpers.camera_subsets import draw_views, judge, restrict
from helpers.stored_captures import StoredMatcher, SubsetMatcher, copy_matches
from zeroshop_steps.register.matching.network_matches import write_matches
from zeroshop_steps.register.scene.image_set import ImageSet

RINGS = [ring_camera(number, 20, 500.0, (0.0, 45.0), (0.0, 0.0, 0.0), 600.0, (640, 480)) for number in range(20)]
"""By turns at 45 and at 0 degrees."""


SIZES = [("all", 20, 20), ("random", 12, 18), ("half", 11, 12), ("gap", 15, 15), ("ring", 10, 10), ("single", 10, 10)]


@pytest.mark.parametrize("kind, least, most", SIZES)
def test_subsets_have_the_size_of_their_kind(kind, least, most):
    for seed in range(5):
        drawn = draw_views(RINGS, kind, np.random.default_rng(seed))
        assert least <= len(drawn) <= most and (np.diff(drawn) > 0).all()


def test_the_lowest_ring_is_not_above():
    assert draw_views(RINGS, "above", np.random.default_rng(0)).tolist() == list(range(0, 20, 2))


def test_the_network_is_asked_once(tmp_path):
    asked = []

    class Network:
        keypoints = [np.full((2, 2), float(number)) for number in range(4)]

        def similarities(self):
            return np.arange(16.0).reshape(4, 4)

        def match(self, first, second):
            asked.append((first, second))
            return np.zeros((0, 2), int), np.zeros(0)

    stored = StoredMatcher(tmp_path / "matches", Network)
    some = SubsetMatcher(stored, np.array([0, 2, 3]))
    assert some.similarities().tolist() == [[0, 2, 3], [8, 10, 11], [12, 14, 15]] and some.keypoints[1][0, 0] == 2.0
    some.match(0, 1)
    stored.save()
    SubsetMatcher(StoredMatcher(tmp_path / "matches", Network), np.array([0, 1, 2])).match(0, 2)
    assert asked == [(0, 2)]


def test_a_subset_has_the_matches_of_its_views(tmp_path):
    rng = np.random.default_rng(0)
    paths = [tmp_path / f"{number}.png" for number in range(4)]
    for path in paths:
        cv2.imwrite(str(path), rng.integers(0, 255, (48, 64, 3), np.uint8))
    images = ImageSet(tuple(paths), None, ((64, 48),) * 4)
    points = rng.uniform(5, 40, (30, 2))
    numbers = np.arange(30)
    matches = {(0, 1): (numbers, numbers), (0, 2): (numbers[:20], numbers[:20]), (2, 3): (numbers, numbers)}
    write_matches(tmp_path / "all.db", images, [points + number for number in range(4)], matches, 2, seed=0)
    some = restrict(images, np.array([0, 2, 3]))
    copy_matches(tmp_path / "all.db", tmp_path / "some.db", some, seed=1)
    with pycolmap.Database.open(tmp_path / "some.db") as opened:
        ids = [opened.read_image_with_name(name).image_id for name in some.names]
        counts = [len(opened.read_matches(ids[one], ids[other])) for one, other in ((0, 1), (0, 2), (1, 2))]
        assert counts == [20, 0, 30]
        assert np.allclose(opened.read_keypoints(ids[1])[:, :2], points + 2)
        assert len(opened.read_two_view_geometry(ids[1], ids[2]).inlier_matches) == 30


def test_a_camera_that_is_far_off_makes_cameras_wrong():
    assert judge(RINGS, RINGS)["cameras"] == "right"
    off = [replace(RINGS[5], name=camera.name) if number == 3 else camera for number, camera in enumerate(RINGS)]
    assert judge(off, RINGS)["cameras"] == "wrong"


def test_of_opposite_views_a_single_one_is_drawn():
    drawn = draw_views(RINGS, "single", np.random.default_rng(0))
    assert not {(number + 10) % 20 for number in drawn} & set(drawn.tolist()) and len(set(drawn % 10)) == 10
