"""Which pairs are matched, and which keypoints count."""

from itertools import combinations

import numpy as np
import pytest

from zeroshop_steps.register.features.sift import SiftOptions, fit_to_count
from zeroshop_steps.register.matching.network_matches import find_long_tracks
from zeroshop_steps.register.matching.pair_selection import choose_alike_pairs, choose_pairs


def ring_similarities(count):
    """Of cameras on a circle."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.cos(angle[:, None] - angle)


def test_small_sets_are_matched_whole_without_looking():
    assert choose_pairs(5, 20, 10, lambda: pytest.fail("needs no similarities")) == list(combinations(range(5), 2))
    assert choose_pairs(2, 20, 10, lambda: pytest.fail("needs no similarities")) == [(0, 1)]
    assert choose_pairs(1, 20, 10, lambda: pytest.fail("needs no similarities")) == []


@pytest.mark.parametrize("count", [40, 300])
def test_large_sets_hang_together_by_neighbours_and_anchors(count):
    pairs = choose_pairs(count, 10, 4, lambda: ring_similarities(count))
    assert all(first < second for first, second in pairs) and len(set(pairs)) == len(pairs)
    assert {(index, index + 1) for index in range(count - 1)} <= set(pairs), "neighbours on the ring"
    assert len(pairs) < count * 6 + 45
    reached = {0}
    for _ in range(count):
        reached |= {b for a, b in pairs if a in reached} | {a for a, b in pairs if b in reached}
    assert reached == set(range(count))


def test_keypoints_count_from_tracks_of_enough_images_on():
    # Keypoint 0 of four images hangs together in a chain, keypoint 1 of two of them is a track of two.
    one = np.array([0])
    matches = {(0, 1): (np.array([0, 1]), np.array([0, 1])), (1, 2): (one, one), (2, 3): (one, one)}
    counts = [2, 2, 1, 1]
    assert [mask.tolist() for mask in find_long_tracks(counts, matches, 4)] == [[True, False], [True, False], [True], [True]]
    assert all(mask.all() for mask in find_long_tracks(counts, matches, 2))
    assert not any(mask.any() for mask in find_long_tracks(counts, matches, 5))
    assert find_long_tracks([0, 0], {}, 2)[0].shape == (0,)


@pytest.mark.parametrize("count", [31, 100])
def test_features_are_matched_between_alike_images_that_hang_together(count):
    angle = np.linspace(0, 2 * np.pi, count // 2 + 1)
    ring = np.maximum(0, 60 * np.cos(angle[:, None] - angle)).round()
    # Two rounds around the object that have hardly anything in common, except in one place.
    similar = np.kron(np.eye(2), ring)
    similar[0, len(ring)] = similar[len(ring), 0] = 3
    pairs = choose_alike_pairs(similar, 6)
    assert all(first < second for first, second in pairs) and len(pairs) <= 6 * len(similar) + 1
    assert (0, len(ring)) in pairs and (0, 1) in pairs
    reached = {0}
    for _ in similar:
        reached |= {b for a, b in pairs if a in reached} | {a for a, b in pairs if b in reached}
    assert reached == set(range(len(similar)))


def test_many_images_get_fewer_features_each():
    options = SiftOptions()
    assert fit_to_count(options, 30) == options
    many = fit_to_count(options, 31)
    assert many.max_features < options.max_features and many.max_side_px < options.max_side_px
    assert fit_to_count(SiftOptions(max_features=500), 31).max_features == 500
