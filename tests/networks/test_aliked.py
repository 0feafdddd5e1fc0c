"""ALIKED and LightGlue: places are those of the image, weights fit wholly or not at all, and outputs are those of the published code."""

from pathlib import Path

import numpy as np
import pytest
import torch
from kornia.feature import ALIKED, LightGlue

from helpers.paths import REPOSITORY
from zeroshop_steps.networks.aliked import (
    EXTRACTOR,
    FOLDER,
    MATCHER,
    AlikedMatcher,
    CropFeatures,
    cut_out,
    describe_turned,
    extract_features,
    find_weights,
    load_extractor,
    load_matcher,
)
from zeroshop_steps.networks.weights import WEIGHTS_FOLDER
from zeroshop_steps.runtime.errors import StepError

RECORD = REPOSITORY / "tests/parity/aliked.npz"
CPU = torch.device("cpu")


def blobs(shift_px: int = 0, size: int = 160) -> np.ndarray:
    """(size, size, 3) smooth noise, moved to the left."""
    rng = np.random.default_rng(3)
    noise = np.zeros((size, size + 40))
    for scale in (4, 8, 16):
        coarse = rng.normal(size=((size + 40) // scale + 2, (size + 40) // scale + 2))
        noise += np.kron(coarse, np.ones((scale, scale)))[:size, : size + 40]
    noise = np.clip(128 + 40 * noise, 0, 255).astype(np.uint8)
    return np.repeat(noise[:, shift_px : shift_px + size, None], 3, axis=2)


def require_published_weights() -> Path:
    """Their folder; skips the test where they are not there."""
    folder = REPOSITORY / WEIGHTS_FOLDER / FOLDER
    if not all((folder / name).is_file() for name in (EXTRACTOR, MATCHER)):
        pytest.skip(f"the weights in {folder} are not there; `snakemake {WEIGHTS_FOLDER / FOLDER}/...` downloads them")
    return folder


@pytest.fixture(scope="module")
def networks(tmp_path_factory):
    """Random weights of the published sizes, in the publisher's names."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    extractor = {name: tensor for name, tensor in ALIKED("aliked-n16").state_dict().items() if name != "dkd.hw_grid"}
    matcher = {}
    for name, tensor in LightGlue(features=None, input_dim=128).state_dict().items():
        parts = name.split(".")
        if name != "confidence_thresholds":
            matcher[".".join([parts[2], parts[1], *parts[3:]]) if parts[0] == "transformers" else name] = tensor
    torch.save(extractor, folder / EXTRACTOR)
    torch.save(matcher, folder / MATCHER)
    return folder


def test_a_crop_tells_where_its_pixels_are_in_the_image():
    image = np.zeros((100, 200, 3), np.uint8)
    image[40:60, 120:160] = 255
    mask = image[..., 0] > 0
    crop = cut_out(image, mask, 100, 0.1, 4.0, 2)
    assert crop.corner_px == (116, 36) and crop.scale == pytest.approx(100 / 48) and crop.pixels.shape == (58, 100, 3)
    rows, columns = np.nonzero(crop.allowed)
    x, y = (columns + 0.5) / crop.scale + 116, (rows + 0.5) / crop.scale + 36
    assert 121.5 < x.min() < 123 and 157 < x.max() < 158.5 and 41.5 < y.min() < 43 and 57 < y.max() < 58.5, "the mask without its rim"
    whole = cut_out(image, np.ones_like(mask), 100, 0.1, 4.0, 2)
    assert whole.corner_px == (0, 0) and whole.allowed.all() and whole.pixels.shape == (50, 100, 3)
    assert cut_out(image, mask, 1000, 0.1, 4.0, 2).scale == 4.0


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_features_of_a_turned_picture_are_at_the_same_places(networks, quarters):
    image, mask = blobs(size=90)[:70], np.zeros((70, 90), bool)
    mask[8:60, 10:80] = True
    crop, extractor = cut_out(image, mask, 90, 0.1, 4.0, 2), load_extractor(networks / EXTRACTOR)
    with torch.no_grad():
        found = extract_features(extractor, crop, CPU, 60, 0.0)
        turned = describe_turned(extractor, crop, found, quarters)
    there = np.rot90(crop.pixels, quarters)
    assert turned.size_px == there.shape[1::-1] and turned.descriptors.shape == found.descriptors.shape
    columns, rows = found.keypoints.round().long().T
    turned_columns, turned_rows = turned.keypoints.round().long().T
    assert (there[turned_rows, turned_columns] == crop.pixels[rows, columns]).all()
    assert not torch.equal(turned.descriptors, found.descriptors)


def test_features_lie_inside_the_mask_at_the_image_s_own_pixels(networks):
    image, mask = blobs(), np.zeros((160, 160), bool)
    mask[30:90, 40:130] = True
    crops = [cut_out(image, mask, 150, 0.1, 4.0, 2), cut_out(image, np.ones_like(mask), 160, 0.1, 4.0, 2)]
    matcher = AlikedMatcher(load_extractor(networks / EXTRACTOR), load_matcher(networks / MATCHER), crops, CPU, 200, 0.0)
    inside = matcher.keypoints[0]
    assert 20 < len(inside) <= 200 and len(matcher.keypoints[1]) == 200
    assert (inside >= [41, 31]).all() and (inside <= [129, 89]).all()
    assert matcher.features[0].descriptors.norm(dim=1).sub(1).abs().max() < 1e-5
    numbers, scores = matcher.match(0, 1)
    assert numbers.shape == (len(scores), 2)
    similarities = matcher.similarities()
    assert similarities.shape == (2, 2) and (similarities == similarities.T).all()


def test_a_picture_without_features_matches_nothing(networks):
    plain = cut_out(np.full((64, 64, 3), 90, np.uint8), np.ones((64, 64), bool), 64, 0.1, 4.0, 2)
    matcher = AlikedMatcher(load_extractor(networks / EXTRACTOR), load_matcher(networks / MATCHER), [plain, plain], CPU, 200, 1.0)
    numbers, scores = matcher.match(0, 1)
    assert numbers.shape == (0, 2) and len(scores) == 0 and matcher.similarities().sum() == 0


def test_weights_of_another_network_are_refused(networks):
    with pytest.raises(StepError, match="does not fit ALIKED"):
        load_extractor(networks / MATCHER)
    with pytest.raises(StepError, match="does not fit LightGlue"):
        load_matcher(networks / EXTRACTOR)
    with pytest.raises(StepError, match=f"{EXTRACTOR} do not exist"):
        find_weights(networks / "nowhere")
    assert find_weights(networks) == (networks / EXTRACTOR, networks / MATCHER)


def test_the_published_weights_give_what_the_published_code_gives():
    """Positions of keypoints, descriptors there and matches with their scores; recorded as tests/parity/README.md says."""
    folder = require_published_weights()
    record = np.load(RECORD)
    crops = [cut_out(blobs(shift), np.ones((160, 160), bool), 160, 0.1, 4.0, 2) for shift in (0, 12)]
    matcher = AlikedMatcher(load_extractor(folder / EXTRACTOR), load_matcher(folder / MATCHER), crops, CPU, 100, 0.005)
    for image, features in enumerate(matcher.features):
        theirs, descriptors = torch.from_numpy(record[f"keypoints_{image}"]), torch.from_numpy(record[f"descriptors_{image}"])
        distance, nearest = torch.cdist(features.keypoints, theirs).min(1)
        assert (distance < 0.1).float().mean() > 0.95 and (same := distance < 1e-3).float().mean() > 0.8
        assert (features.descriptors[same] - descriptors[nearest[same]]).abs().max() < 1e-4
        matcher.features[image] = CropFeatures(theirs, descriptors, (160, 160))
    numbers, scores = matcher.match(0, 1)
    assert (numbers == record["matches"]).all() and np.abs(scores - record["scores"]).max() < 1e-4
    moved = record["keypoints_0"][numbers[:, 0], 0] - record["keypoints_1"][numbers[:, 1], 0]
    assert (scores > 0.85).sum() > 30 and (np.abs(moved - 12)[scores > 0.85] < 1.5).mean() > 0.95


def test_half_precision_hardly_moves_features(monkeypatch):
    """As CUDA runs ALIKED (networks/devices.py); LightGlue stays in single precision of itself."""
    folder = require_published_weights()
    crops = [cut_out(blobs(shift), np.ones((160, 160), bool), 160, 0.1, 4.0, 2) for shift in (0, 12)]
    extractor, matcher = load_extractor(folder / EXTRACTOR), load_matcher(folder / MATCHER)
    exact = AlikedMatcher(extractor, matcher, crops, CPU, 100, 0.005)
    monkeypatch.setattr("zeroshop_steps.networks.devices.choose_precision", lambda *_: torch.bfloat16)
    half = AlikedMatcher(extractor, matcher, crops, CPU, 100, 0.005)
    for expected, found in zip(exact.features, half.features, strict=True):
        distance, nearest = torch.cdist(found.keypoints, expected.keypoints).min(1)
        same = distance < 1.0
        likeness = (found.descriptors * expected.descriptors[nearest]).sum(1)
        assert not torch.equal(found.keypoints, expected.keypoints), "something ran in half precision"
        assert same.float().mean() > 0.9 and distance[same].median() < 0.05 and likeness[same].median() > 0.99
    before, after = exact.match(0, 1)[0], half.match(0, 1)[0]
    assert len(after) > 0.9 * len(before) > 30
    moved = half.keypoints[0][after[:, 0], 0] - half.keypoints[1][after[:, 1], 0]
    assert np.median(np.abs(moved - 12)) < 0.2


def test_the_quarter_turn_in_which_pictures_are_alike_is_found():
    folder = require_published_weights()
    image, whole = blobs(size=120), np.ones((120, 120), bool)
    crops = [cut_out(np.ascontiguousarray(np.rot90(image, quarters)), whole, 120, 0.1, 4.0, 2) for quarters in range(4)]
    matcher = AlikedMatcher(load_extractor(folder / EXTRACTOR), load_matcher(folder / MATCHER), crops, CPU, 200, 0.001, range(1, 4))
    assert [matcher.find_quarter(0, turned)[0] for turned in (1, 2, 3)] == [3, 2, 1]
    numbers, scores = matcher.match(0, 2, 2)
    sure = numbers[scores > 0.85]
    one, other = matcher.keypoints[0][sure[:, 0]], matcher.keypoints[2][sure[:, 1]]
    assert len(sure) > 30 and np.median(np.linalg.norm(120 - other - one, axis=1)) < 2.0, "each place is found where the half turn put it"
    assert (matcher.match(0, 2)[1] > 0.85).sum() < len(sure) / 2
