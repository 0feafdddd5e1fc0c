"""Masks for pose estimation: the surest detection of every pixel, nothing unsure."""

from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.bop.formats.detections import Detection, decode_mask, encode_mask, read_detections, write_detections
from zeroshop_steps.detect.filter_masks import filter_detections
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError


def detection(object_id: int, score: float, columns: slice, image: int = 0, size: int = 20) -> Detection:
    mask = np.zeros((10, size), bool)
    mask[:, columns] = True
    return Detection(1, image, object_id, score, (0, 0, 1, 1), encode_mask(mask), 0.5)


def test_each_pixel_is_the_surest_detections():
    sure, less, double, unsure = (
        detection(1, 0.9, np.s_[:10]),
        detection(2, 0.6, np.s_[6:18]),
        detection(3, 0.5, np.s_[2:8]),
        detection(4, 0.1, np.s_[18:]),
    )
    other = detection(3, 0.3, np.s_[2:8], image=1)
    kept = filter_detections([double, unsure, other, less, sure], 0.2, Path("found.json"))
    assert sorted((one.image_id, one.object_id) for one in kept) == [(0, 1), (0, 2), (1, 3)]
    masks = {(one.image_id, one.object_id): decode_mask(one.mask) for one in kept}
    assert masks[0, 1][0].nonzero()[0].tolist() == list(range(10))
    assert masks[0, 2][0].nonzero()[0].tolist() == list(range(10, 18)), "what the surer one has is not painted over"
    assert masks[1, 3].sum() == 60, "images have nothing to do with each other"
    assert {one.object_id: one.box_px for one in kept}[2] == (10, 0, 8, 10)
    assert {one.score for one in kept} == {0.9, 0.6, 0.3} and kept[0].seconds == 0.5


def test_no_detections_are_no_masks():
    assert filter_detections([], 0.2, Path("found.json")) == []
    assert filter_detections([detection(1, 0.1, np.s_[:5])], 0.2, Path("found.json")) == []


def test_bad_detections_are_named():
    with pytest.raises(StepError, match="object 1 in scene 1, image 0 has no segmentation"):
        filter_detections([Detection(1, 0, 1, 0.9, (0, 0, 5, 5), None)], 0.2, Path("found.json"))
    with pytest.raises(StepError, match="20 x 10 px and 30 x 10 px"):
        filter_detections([detection(1, 0.9, np.s_[:5]), detection(2, 0.8, np.s_[:5], size=30)], 0.2, Path("found.json"))


def run(dataset, found) -> int:
    write_detections(dataset.folder / "found.json", found)
    words = ["--method", "filter_masks", "--detections", dataset.folder / "found.json", "--models", dataset.folder / "models"]
    return stage_main("zeroshop_steps.detect", ["--method", "filter_masks", *map(str, words), "--out", str(dataset.folder / "masks.json")])


def test_the_command(dataset, capsys):
    assert run(dataset, [detection(3, 0.9, np.s_[:5]), detection(8, 0.19, np.s_[5:])]) == 0
    assert [one.object_id for one in read_detections(dataset.folder / "masks.json")] == [3]
    assert run(dataset, []) == 0
    assert read_detections(dataset.folder / "masks.json") == []
    assert run(dataset, [detection(5, 0.9, np.s_[:5])]) == 1
    assert "names the objects [5], which have no model" in capsys.readouterr().err
