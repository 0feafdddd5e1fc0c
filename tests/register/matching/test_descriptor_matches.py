"""Matching of descriptors, against a readable twin."""

import numpy as np
import pytest

from zeroshop_steps.register.matching.descriptor_matches import BLOCK_ROWS, LARGEST_ANGLE, LARGEST_RATIO, match_descriptors


def make_descriptors(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 128) uint8 of length 512 or so."""
    values = rng.gamma(0.6, size=(count, 128))
    return np.round(512 * values / np.linalg.norm(values, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)


def match_one_by_one(first: np.ndarray, second: np.ndarray) -> list[tuple[int, int]]:
    """What `match_descriptors` says, pair by pair."""
    angles = np.arccos(np.clip(first.astype(float) @ second.T.astype(float) / 512**2, 0, 1))
    found = []
    for one, row in enumerate(angles):
        other = int(row.argmin())
        if angles[:, other].argmin() != one or row[other] > LARGEST_ANGLE:
            continue
        next_angles = np.delete(row, other), np.delete(angles[:, other], one)
        if all(row[other] < LARGEST_RATIO * min(others, default=np.pi / 2) for others in next_angles):
            found.append((one, other))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_matches_are_those_of_the_readable_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = make_descriptors(rng, BLOCK_ROWS + 70)
    seen_again = rng.permutation(len(first))[:90]
    noise = rng.normal(0, 8, (90, 128))
    second = np.concatenate([make_descriptors(rng, 60), (first[seen_again] + noise).clip(0, 255).astype(np.uint8)])
    found = match_descriptors(first, second)
    assert [tuple(pair) for pair in found.tolist()] == match_one_by_one(first, second)
    assert len(found) > 60


def test_a_descriptor_that_occurs_twice_matches_nothing() -> None:
    first = make_descriptors(np.random.default_rng(0), 5)
    second = np.concatenate([first, first[2:3]])
    assert match_descriptors(first, second)[:, 0].tolist() == [0, 1, 3, 4]
    assert match_descriptors(second, first)[:, 1].tolist() == [0, 1, 3, 4]


@pytest.mark.parametrize(("one", "other"), [(0, 3), (3, 0), (0, 0), (1, 1)])
def test_few_descriptors_or_none(one: int, other: int) -> None:
    descriptors = make_descriptors(np.random.default_rng(0), 3)
    found = match_descriptors(descriptors[:one], descriptors[:other])
    assert found.shape == ((1, 2) if one and other else (0, 2))
