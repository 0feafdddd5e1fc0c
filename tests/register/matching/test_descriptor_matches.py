"""Matching of descriptors, against a readable twin."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.matching.descriptor_matches import BLOCK_ROWS, LARGEST_ANGLE, LARGEST_RATIO, match_descriptors
from zeroshop_steps.register.matching.verified_matches import LEAST_PROBES_MATCHED, PROBES, match_features


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


def test_a_pair_whose_largest_features_do_not_match_has_no_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Probes have numbers of their own, which must not be taken for those of features."""
    rng = np.random.default_rng(0)
    described = [make_descriptors(rng, PROBES + 300) for _ in range(2)]
    described[1][:LEAST_PROBES_MATCHED] = described[0][:LEAST_PROBES_MATCHED]  # of the smallest scales, and 3 of the largest
    described[1][-3:] = described[0][-3:]
    keypoints = np.zeros((PROBES + 300, 6), np.float32)
    keypoints[:, :2], keypoints[:, 2] = rng.uniform(0, 100, (len(keypoints), 2)), np.arange(1, len(keypoints) + 1)
    keypoints[:, 5] = keypoints[:, 2]
    database = tmp_path / "database.db"
    with pycolmap.Database.open(database) as opened:
        camera = opened.write_camera(pycolmap.Camera.create_from_model_name(0, "PINHOLE", 100.0, 100, 100))
        for name, data in zip(("a.png", "b.png"), described, strict=True):
            image_id = opened.write_image(pycolmap.Image(name=name, camera_id=camera))
            opened.write_keypoints(image_id, keypoints)
            opened.write_descriptors(image_id, pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, data))
    monkeypatch.setattr(pycolmap, "verify_matches", lambda *_: None)  # it would delete so few
    match_features(database, SiftOptions(threads=1))
    with pycolmap.Database.open(database) as opened:
        assert opened.exists_matches(1, 2)
        assert sum(map(len, opened.read_all_matches()[1])) == 0
