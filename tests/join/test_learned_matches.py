"""Learned features across passes: which pairs are matched, in which roll, and what happens without weights."""

from argparse import Namespace

import numpy as np
import pytest

from zeroshop_steps.join.learned_matches import OPTIONS, PARTNERS, choose_pairs, load_networks
from zeroshop_steps.networks.aliked import FOLDER
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.register.aliked import match_pairs
from zeroshop_steps.runtime.errors import StepError

COUNTS = (8, 9, 8)  # images of the passes


class KnownLikeness:
    """Images are like those with near numbers; those of later passes are upside down."""

    def __init__(self) -> None:
        self.turned = set(range(COUNTS[0], sum(COUNTS)))

    def similarities(self) -> np.ndarray:
        numbers = np.arange(sum(COUNTS))
        return 100.0 - np.abs(numbers[:, None] - numbers)

    def find_quarter(self, first: int, second: int) -> tuple[int, float]:
        assert second in self.turned and first < COUNTS[0]
        return 2, 50.0 - abs(second % COUNTS[0] - first)

    def match(self, first: int, second: int, quarters: int = 0) -> tuple[np.ndarray, np.ndarray]:
        assert quarters == (2 if first < COUNTS[0] <= second else 0)
        scores = np.concatenate([np.full(OPTIONS.sure_matches - (first == 0), 0.9), np.full(5, 0.5), np.full(5, 0.1)])
        return np.stack([np.arange(len(scores))] * 2, 1), scores


def test_each_image_is_matched_in_its_pass_and_with_the_first_one():
    pairs, quarters = choose_pairs(KnownLikeness(), list(COUNTS))
    assert pairs == sorted(set(pairs)) and all(one < other for one, other in pairs)
    groups = np.repeat(np.arange(3), COUNTS)
    assert {(groups[one], groups[other]) for one, other in pairs} == {(0, 0), (1, 1), (2, 2), (0, 1), (0, 2)}
    assert set(quarters.values()) == {2} and len(quarters) == COUNTS[0] * sum(COUNTS[1:])
    for image in range(sum(COUNTS)):
        partners = [groups[other if one == image else one] for one, other in pairs if image in (one, other)]
        assert all(partners.count(group) >= PARTNERS for group in {0, groups[image]})


def test_pairs_with_few_sure_matches_do_not_count_and_of_the_others_the_good_ones_do():
    matcher, quarters = KnownLikeness(), {(1, 9): 2}
    found = match_pairs(lambda one, other: matcher.match(one, other, quarters.get((one, other), 0)), [(0, 1), (1, 2), (1, 9)], OPTIONS)
    assert set(found) == {(1, 2), (1, 9)}
    assert all(len(one) == len(other) == OPTIONS.sure_matches + 5 for one, other in found.values())


def test_without_weights_nothing_is_learned_but_a_folder_of_ones_own_must_hold_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_networks(Namespace(weights=WEIGHTS_FOLDER / FOLDER, device="cpu", threads=1)) is None
    with pytest.raises(StepError, match="do not exist"):
        load_networks(Namespace(weights=tmp_path, device="cpu", threads=1))
