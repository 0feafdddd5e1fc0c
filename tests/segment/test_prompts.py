"""What Segment Anything is asked, of which part of a photo, and what its answers become; a stub answers in its place."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import pytest

from helpers.table_scene import ball_mask, table_views
from zeroshop_steps.geometry.support.scene_support import SceneSupport
from zeroshop_steps.networks.mobile_sam.model import Features
from zeroshop_steps.segment.cues import prompted
from zeroshop_steps.segment.objects import NothingFound, find_objects, find_whole
from zeroshop_steps.segment.outlines.prompts import POINTS, PromptedSegmenter, find_inner_points
from zeroshop_steps.segment.outlines.windows import Window
from zeroshop_steps.segment.photometry.exposure import Exposure
from zeroshop_steps.segment.scene import Hull, read_mask_scene, start_guess

BALL, COUNT = (0.0, 0.0, 0.5), 8
SIZE = 40  # of the stub's masks


@dataclass
class StubNetwork:
    """Cuts out the box that it is asked for, and half of the image at points."""

    encoded: list[tuple[int, int]] = field(default_factory=list)
    boxes: list[np.ndarray] = field(default_factory=list)
    points: list[np.ndarray] = field(default_factory=list)

    def encode(self, image):
        self.encoded.append(image.shape[1::-1])
        return Features(None, (SIZE, SIZE))

    def decode(self, of_image, points=None, labels=None, box=None):
        odds = np.full((3, SIZE, SIZE), -9, np.float32)
        if box is None:
            self.points.append(points)
            odds[-1, :, : SIZE // 2] = 9
        else:
            self.boxes.append(box)
            (left, top), (right, bottom) = np.round(box * SIZE).astype(int)
            odds[-1, top:bottom, left:right] = 9
        return odds


@pytest.fixture
def table(tmp_path):
    """A scene of a ball, what the views show of it, and the stub that cuts it out."""
    views, model = table_views(tmp_path, [[BALL]] * COUNT)
    network = StubNetwork()
    scene = read_mask_scene(views, model, Exposure(np.zeros((COUNT, 3)), False, []), None, 240, PromptedSegmenter(network))
    return scene, [ball_mask(view.camera, BALL) for view in views], network


def guess_of(scene, truths):
    nothing = [np.zeros_like(truth) for truth in truths]
    hull = Hull(np.ones((1, 1, 1), bool), truths, [truth.astype(np.float32) for truth in truths], nothing)
    return replace(start_guess(scene, None), hull=hull)


def test_points_lie_inside_and_apart():
    shown = np.zeros((60, 80), bool)
    shown[10:30, 5:25], shown[35:50, 40:75] = True, True
    points = find_inner_points(shown)
    assert len(points) == POINTS and all(shown[point] for point in points)
    assert {row < 32 for row, _ in points} == {True, False}, "each part has one"
    assert find_inner_points(np.zeros((5, 5), bool)) == [] and find_inner_points(np.ones((1, 1), bool)) == [(0, 0)]


def test_a_window_is_asked_in_shares_of_what_was_encoded(table):
    scene, _, network = table
    segmenter, view = scene.segmenter, scene.views[0]
    shown = np.zeros((10, 20), bool)
    shown[4:6, 10:15] = True
    around, masks = segmenter.cut(scene.photos[0], view, Window(100, 80, 140, 100), shown)
    assert around == Window(94, 77, 146, 103) and network.encoded == [(52, 26)]
    assert np.allclose(network.boxes[0], [[26 / 52, 11 / 26], [36 / 52, 15 / 26]])
    assert masks.shape == (2, SIZE, SIZE)
    column, row = network.points[0][0] * (20 * 52 / 40, 10 * 26 / 20) - (3, 1.5)
    assert shown[int(row), int(column)], "points lie where the object is shown"


def test_a_window_like_an_earlier_one_is_not_encoded_again(table):
    scene, _, network = table
    ask = [scene.photos[0], scene.views[0]]
    shown = np.ones((10, 20), bool)
    first, _ = scene.segmenter.cut(*ask, Window(100, 80, 140, 100), shown)
    assert scene.segmenter.cut(*ask, Window(98, 79, 138, 101), shown)[0] == first and len(network.encoded) == 1
    scene.segmenter.cut(*ask, Window(110, 85, 120, 95), shown)
    assert len(network.encoded) == 2, "a much smaller one is looked at closer"
    scene.segmenter.cut(scene.photos[1], scene.views[1], Window(100, 80, 140, 100), shown)
    assert len(network.encoded) == 3


def test_the_cue_is_what_the_network_cuts_out_and_how_far_views_agree(table):
    scene, truths, _ = table
    see = prompted.prepare(scene, guess_of(scene, truths))
    for index in (0, 5):
        boxed, boxed_agrees, pointed, pointed_agrees, known = see(index)
        assert (boxed[truths[index]] > 0).mean() > 0.95 and (known == 1).all()
        assert 0.6 < boxed_agrees[0, 0] < 0.9, "a ball fills pi / 4 of its box"
        assert pointed.shape == truths[index].shape and pointed_agrees[0, 0] < 0.3


def test_without_a_hull_or_a_network_the_cue_knows_nothing(table):
    scene, truths, _ = table
    assert prompted.prepare(scene, start_guess(scene, None)) is None
    assert prompted.prepare(replace(scene, segmenter=None), guess_of(scene, truths)) is None


def test_views_that_are_not_asked_or_show_nothing_say_nothing(table, monkeypatch):
    scene, truths, network = table
    monkeypatch.setattr(prompted, "MOST_VIEWS", 3)
    see = prompted.prepare(scene, guess_of(scene, [truths[0] & False, *truths[1:]]))
    known = [bool(see(index)[-1].any()) for index in range(COUNT)]
    assert sum(known) == 2 and not known[0] and len(network.encoded) == 2


def test_the_whole_is_seen_in_the_photos_that_windows_are_of(table):
    """The stub sees the left half of what it encoded; beyond the window nobody was asked."""
    scene, truths, _ = table
    windows = [Window(60, 40, 180, 140)] * COUNT
    closer = scene.look_closer(windows, None)
    looked = [
        cv2.resize(truth.astype(np.uint8)[40:140, 60:180], image.shape[1::-1]) > 0
        for truth, image in zip(truths, closer.images, strict=True)
    ]
    (seen, *_) = prompted.see_whole(scene, closer, guess_of(closer, looked))
    assert seen.shape == truths[0].shape
    assert (seen[40:140, 62:115] > 7).all() and (seen[40:140, 125:178] < -7).all()
    assert not seen[:, :60].any() and not seen[:, 180:].any() and not seen[:40].any() and not seen[140:].any()
    assert prompted.see_whole(scene, scene, start_guess(scene, None)) is None


def test_a_part_is_told_from_the_whole_that_another_cue_sees(table):
    """Two balls that touch are the whole of the first; alone it is its own whole."""
    scene, truths, _ = table
    cameras, (focus, distance) = scene.cameras, scene.focus
    plane = SceneSupport(np.array([0.0, 0.0, 1.0]), 0.0, focus, distance, 0)
    points = np.random.default_rng(0).uniform(-1, 1, (4000, 3))
    points = np.array(BALL) + BALL[2] * points[np.linalg.norm(points, axis=1) < 1]
    both = [truth | ball_mask(camera, (0.7, 0.0, 0.4)) for truth, camera in zip(truths, cameras, strict=True)]
    alone, larger = (
        find_objects(cameras, plane, focus, distance, [np.where(mask, 8, -8).astype(np.float32) for mask in masks])
        for masks in (truths, both)
    )
    (own, same), (number, overlap) = (find_whole(found, cameras, points) for found in (alone, larger))
    assert same > 0.9 and overlap < 0.8
    assert (larger.labels == number).sum() > 1.3 * (alone.labels == own).sum()
    with pytest.raises(NothingFound):
        find_whole(alone, cameras, points + 1.5)
