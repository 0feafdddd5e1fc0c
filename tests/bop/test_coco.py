"""Detections in COCO's other forms: polygons, and whole datasets."""

import json
from pathlib import Path

import pytest

from zeroshop_steps.bop.formats.detections import decode_mask, read_detections
from zeroshop_steps.runtime.errors import StepError

SQUARE = [[10, 20, 30, 20, 30, 40, 10, 40]]
ENTRY = {"scene_id": 1, "image_id": 3, "category_id": 5, "score": 0.9, "bbox": [10, 20, 20, 20], "segmentation": SQUARE}


def write(path: Path, content: object) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(content))
    return path


def test_polygons_are_filled(tmp_path: Path) -> None:
    two = ENTRY | {"segmentation": [*SQUARE, [50, 50, 60, 50, 60, 60, 50, 60]]}
    one, both = read_detections(write(tmp_path / "found.json", [ENTRY, two]), lambda scene, image: (80, 64))
    mask = decode_mask(one.require_mask())
    assert mask.shape == (64, 80) and mask[21:39, 11:29].all() and mask.sum() == pytest.approx(400, abs=45)
    assert decode_mask(both.require_mask())[51:59, 51:59].all()


@pytest.mark.parametrize("folder", ["000001", "coco"])
def test_a_whole_dataset_is_read(tmp_path: Path, folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    of_image = {"image_id": 3, "category_id": 5, "bbox": [10, 20, 20, 20], "segmentation": SQUARE, "iscrowd": 0, "id": 1, "area": 400}
    image = {"id": 3, "width": 80, "height": 64, "file_name": "rgb/000003.png"} | ({} if folder == "000001" else {"scene_id": 1})
    path = write(tmp_path / folder / "scene_gt_coco.json", {"images": [image], "annotations": [of_image], "categories": []})
    (found,) = read_detections(path)
    assert (found.scene_id, found.image_id, found.object_id, found.score) == (1, 3, 5, 1.0)
    assert decode_mask(found.require_mask()).shape == (64, 80) and "whole COCO dataset" in capsys.readouterr().err
    path.write_text(json.dumps({"images": [], "annotations": [], "categories": []}))
    assert read_detections(path) == []


def test_run_lengths_may_be_floats(tmp_path: Path) -> None:
    """As some writers of JSON make of all numbers."""
    entry = ENTRY | {"segmentation": {"size": [4, 5], "counts": [3.0, 2.0, 15.0]}}
    assert decode_mask(read_detections(write(tmp_path / "found.json", [entry]))[0].require_mask()).sum() == 2
    assert read_detections(write(tmp_path / "found.json", [entry | {"segmentation": None}]))[0].mask is None


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ([ENTRY], r"found\.json: entry 0: its segmentation is a polygon, and the size of its image is unknown; give the whole"),
        ([ENTRY | {"segmentation": [[1, 2, 3, 4, 5, 6, 7]]}], "unknown|odd number of coordinates"),
        ([ENTRY | {"segmentation": [[1, 2]]}], r"found\.json: at 0 / segmentation"),
        ({"images": [{"id": 3}], "annotations": [{"image_id": 3, "category_id": 5}]}, "images have no scene_id; add it"),
        ({"images": []}, "'annotations' is a required property"),
    ],
)
def test_what_is_missing_is_named(tmp_path: Path, content: object, says: str) -> None:
    with pytest.raises(StepError, match=says):
        read_detections(write(tmp_path / "found.json", content))
