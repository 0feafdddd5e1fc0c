"""Pairs of sides that look alike do not close around the object, and are found; a guessed focal length does not hide them."""

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.register.matching.rotation_consistency import find_contradicting


def ring(count: int, false: list[tuple[int, int]], bend: float = 1.0, weight: float = 50.0) -> dict:
    """Cameras around an object, each tied to its two neighbours on both sides; `false` pairs claim one direction; `bend` scales angles."""
    step = 360.0 / count
    pairs = {}
    for first in range(count):
        for second in (first + 1, first + 2):
            noise = Rotation.random(random_state=first * 40 + second).as_rotvec() * 0.02
            turn = Rotation.from_euler("y", bend * (second - first) * step, degrees=True) * Rotation.from_rotvec(noise)
            one, other = first, second % count
            pairs[min(one, other), max(one, other)] = ((turn if one < other else turn.inv()).as_matrix(), 200.0)
    return pairs | {pair: (np.eye(3), weight) for pair in false}


def test_pairs_that_agree_are_all_kept():
    assert find_contradicting(ring(10, []), 0) == set()
    assert find_contradicting({}, 0) == set()


def test_front_matched_with_back_is_found_also_with_a_wrong_focal_length():
    false = [(0, 5), (1, 6), (2, 7), (3, 8), (0, 4)]
    assert find_contradicting(ring(10, false), 0) == set(false)
    assert find_contradicting(ring(10, false, bend=0.9), 0) == set(false)


def test_heavy_false_pairs_lose_against_more_that_agree():
    assert find_contradicting(ring(12, [(0, 6), (2, 8)], weight=400.0), 1) == {(0, 6), (2, 8)}


def test_two_groups_without_a_tie_are_not_compared():
    pairs = ring(6, [])
    assert find_contradicting(pairs | {(first + 10, second + 10): value for (first, second), value in pairs.items()}, 0) == set()
