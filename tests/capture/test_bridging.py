"""Frames between two that share too little; nothing where they share enough."""

import numpy as np
import pytest

from capture.test_video import film
from zeroshop_steps.capture.bridging import SHARED_FEATURES, bridge_gaps, count_shared, find_features
from zeroshop_steps.capture.video import choose_frames, extract_frames, read_frames, scan_video
from zeroshop_steps.runtime.files import read_json


def bridge(path: dict[int, int], chosen: list[int], most: int) -> list[int]:
    """Choose among frames that show a number, which two share the less the more it differs."""

    def between(one: int, other: int) -> int | None:
        return (one + other) // 2 if other - one > 1 else None

    return bridge_gaps(lambda numbers: ((number, path[number]) for number in numbers), chosen, between, most)


@pytest.fixture
def numbered(monkeypatch):
    """Features of a frame are its number; neighbours within ten share enough."""
    monkeypatch.setattr("zeroshop_steps.capture.bridging.find_features", lambda frame: frame)
    monkeypatch.setattr("zeroshop_steps.capture.bridging.count_shared", lambda one, other: 10 * SHARED_FEATURES // abs(one - other))


def test_only_weak_gaps_are_bridged(numbered):
    path = {number: number for number in range(100)}
    assert bridge(path, [0, 10, 20], 60) == [0, 10, 20]
    assert bridge(path, [0, 10, 40, 50], 60) == [0, 10, 17, 25, 32, 40, 50]


def test_the_weakest_first_where_not_all_can_be_bridged(numbered):
    assert bridge({number: number for number in range(100)}, [0, 12, 52], 4) == [0, 12, 32, 52]
    assert bridge({number: number for number in range(100)}, [0, 12, 52], 3) == [0, 12, 52]


def test_a_gap_without_frames_stays(numbered):
    assert bridge({0: 0, 1: 50, 2: 51}, [0, 1, 2], 60) == [0, 1, 2]


def test_views_of_one_place_share_features_and_others_none(tmp_path):
    frames = [find_features(frame) for frame in read_frames(film(tmp_path / "film.avi", [0, 40, 1600]))]
    assert count_shared(frames[0], frames[1]) > SHARED_FEATURES > 20 > count_shared(frames[0], frames[2])
    assert count_shared(frames[0], find_features(np.full((240, 320, 3), 90, np.uint8))) == 0


def test_a_film_gets_frames_where_it_goes_fast(tmp_path):
    way = np.concatenate([np.linspace(0, 400, 60), np.linspace(420, 2000, 50)])
    path = film(tmp_path / "film.avi", way)
    extract_frames(path, 10, 1920, tmp_path / "capture", most=40)
    facts = read_json(tmp_path / "capture/capture.json")
    chosen = facts["source_frames"]
    assert facts["images"] == len(chosen) == 10 + facts["added_frames"] and facts["added_frames"] > 0 and chosen == sorted(set(chosen))
    first = choose_frames(scan_video(path), 10)
    assert np.diff(way[chosen]).max() < 250 < np.diff(way[first]).max(), "frames of 320 px that overlap by a quarter share enough"
