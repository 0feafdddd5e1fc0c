"""Result files: what is written reads back, real submissions are read, and bad rows are named with their line."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.small_dataset import true_estimates
from zeroshop_steps.bop.formats.detections import Detection, _compress, decode_mask, encode_mask, read_detections, write_detections
from zeroshop_steps.bop.formats.estimates import HEADER, read_estimates, write_estimates
from zeroshop_steps.runtime.errors import StepError

GOOD = "1,0,1,0.9,1 0 0 0 1 0 0 0 1,10 -20 500,0.5"


def test_estimates_read_back_exactly(dataset, tmp_path):
    estimates = true_estimates(dataset)
    write_estimates(tmp_path / "poses.csv", estimates)
    again = read_estimates(tmp_path / "poses.csv")
    for name in vars(estimates):
        np.testing.assert_array_equal(getattr(again, name), getattr(estimates, name))
    assert again.seconds_per_image() == 0.5


def test_no_estimates_and_no_header_are_fine(tmp_path, capsys):
    path = tmp_path / "poses.csv"
    for text, count in (
        ("", 0),
        (HEADER + "\n", 0),
        (f"{HEADER}\n\n", 0),
        (GOOD, 1),
        (f"{HEADER.upper()}\r\n{GOOD}\r\n", 1),
        (f"{HEADER}\n{GOOD}\n\n  \r\n", 1),
    ):
        path.write_text(text, newline="")
        estimates = read_estimates(path)
        assert len(estimates) == count
        assert ("poses.csv holds no estimates; every object counts as not found" in capsys.readouterr().err) == (count == 0)
    assert estimates.translations_mm.tolist() == [[10, -20, 500]]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1,0,1,0.9,1 0 0 0 1 0 0 0 1,10 -20 500", "line 3 has 6 fields"),
        ("1,0,1,0.9,1 0 0 0 1 0 0 0,10 -20 500,1", "line 3: R has 8 numbers, expected 9"),
        ("1,0,1,0.9,1 0 0 0 1 0 0 0 1,10 -20,1", "line 3: t has 2 numbers"),
        ("1,0,1,high,1 0 0 0 1 0 0 0 1,10 -20 500,1", "line 3: score holds 'high'"),
        ("1,0,1,0.9,1 0 0 0 1 0 0 0 nan,10 -20 500,0.5", "line 3: R holds numbers that are not finite"),
        ("1,0,1,nan,1 0 0 0 1 0 0 0 1,10 -20 501,0.5", "line 3: score is nan"),
        ("1,0,1,0.9,1 0 0 0 1 0 0 0 1,10 inf 500,0.5", "line 3: t holds numbers that are not finite"),
        ("1,0,1,0.9,1 0 0 0 2 0 0 0 1,10 -20 500,0.5", "line 3: R is no rotation"),
        ("1,0,1,0.9,1 0 0 0 1 0 0 0 -1,10 -20 500,0.5", "line 3: R mirrors"),
        ("1,0.5,1,0.9,1 0 0 0 1 0 0 0 1,10 -20 500,0.5", "line 3: scene_id, im_id and obj_id must be whole"),
        ("1,0,-1,0.9,1 0 0 0 1 0 0 0 1,10 -20 500,0.5", "line 3: scene_id, im_id and obj_id must be whole"),
        ("1,0,2,0.9,1 0 0 0 1 0 0 0 1,10 -20 500,9.5", "line 3: the time differs"),
        ("\n" + GOOD, "line 3 is empty, and more lines follow"),
        (GOOD.replace(",", ";"), "line 3 has 1 fields; expected 7, separated by commas"),
        ("1,0,1,0.9,[1 0 0 0 1 0 0 0 1],10 -20 500,0.5", r"line 3: R holds '\[1', .* without brackets or quotes"),
    ],
)
def test_a_bad_row_is_named(tmp_path, row, message):
    path = tmp_path / "poses.csv"
    path.write_text(f"{HEADER}\n{GOOD}\n{row}\n")
    with pytest.raises(StepError, match=message):
        read_estimates(path)


def test_another_header_is_named(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(f"{HEADER.replace('scene_id,im_id,obj_id', 'scene_id,obj_id,im_id')}\n{GOOD}\n")
    with pytest.raises(StepError, match="line 1 is the header scene_id,obj_id,im_id,score,R,t,time; expected scene_id,im_id,obj_id"):
        read_estimates(path)


def test_spaces_in_the_header_do_not_matter_and_another_encoding_is_named(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(f"{HEADER.replace(',', ', ')}\n{GOOD}\n")
    assert len(read_estimates(path)) == 1
    path.write_text(f"{HEADER}\n{GOOD}\n", encoding="utf-16")
    with pytest.raises(StepError, match=r"poses\.csv is text in UTF-16; save it as CSV in UTF-8"):
        read_estimates(path)


def test_repeated_rows_count_as_in_the_official_loader(tmp_path, capsys):
    path = tmp_path / "poses.csv"
    path.write_text(f"{HEADER}\n{GOOD}\n{GOOD}\n")
    assert len(read_estimates(path)) == 2
    assert "poses.csv, line 3 repeats the pose of line 2" in capsys.readouterr().err


def test_poses_in_metres_are_refused(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(f"{HEADER}\n{GOOD.replace('10 -20 500', '0.01 -0.02 0.5')}\n")
    with pytest.raises(StepError, match="metres, millimetres are expected"):
        read_estimates(path)


def test_blocks_of_a_huge_file_join_seamlessly(tmp_path, monkeypatch):
    path = tmp_path / "poses.csv"
    rows = [f"1,{index},1,0.5,1 0 0 0 1 0 0 0 1,{index} 0 500,0.1" for index in range(2000)]
    path.write_text("\n".join([HEADER, *rows]))
    monkeypatch.setattr("zeroshop_steps.bop.formats.estimates.BLOCK_BYTES", 1000)
    assert read_estimates(path).image_ids.tolist() == list(range(2000))
    path.write_text("\n".join([HEADER, *rows, "broken"]))
    with pytest.raises(StepError, match="line 2002 has 1 fields"):
        read_estimates(path)


@pytest.mark.slow
def test_real_submissions_are_read(shared_data):
    folder = shared_data / "bop" / "scoring"
    files = sorted(folder.glob("cnos*.csv"))
    assert [len(read_estimates(path)) for path in files] == [1645, 4914]
    detections = read_detections(next(folder.glob("*.json.gz")))
    assert len(detections) > 1000 and detections[0].box_px == (205.25, 137.0, 129.5, 194.75) and detections[0].mask is None


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_masks_read_back_exactly(height, width, seed):
    mask = np.random.default_rng(seed).uniform(size=(height, width)) < 0.5
    encoded = encode_mask(mask)
    np.testing.assert_array_equal(decode_mask(encoded), mask)
    assert _compress(Path("found.json"), 0, {"size": [height, width], "counts": encoded["counts"].decode()}) == encoded


def test_detections_read_back(tmp_path):
    mask = np.zeros((6, 7), bool)
    mask[:3, 0] = mask[4, 2:5] = True
    written = [
        Detection(1, 2, 3, 0.25, (1.0, 2.0, 3.0, 4.5), encode_mask(mask), 0.5),
        Detection(1, 2, 4, 0.5, (0.0, 0.0, 2.0, 2.0), None, 0.5),
    ]
    path = tmp_path / "detections.json"
    write_detections(path, written)
    assert read_detections(path) == written
    counts = json.loads(path.read_text())[0]["segmentation"]["counts"]
    assert sum(counts) == 42 and counts[0] == 0 and all(isinstance(count, int) for count in counts)
    with gzip.open(tmp_path / "detections.json.gz", "wt") as file:
        file.write(path.read_text())
    assert read_detections(tmp_path / "detections.json.gz") == written
    write_detections(path, [])
    assert read_detections(path) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"score": "high"}, "at 0 / score"),
        ({"score": float("nan")}, "nan is not a finite number"),
        ({"bbox": [1, 2, 3]}, "expected .x, y, width, height."),
        ({"bbox": [1, 2, -3, 4]}, "expected .x, y, width, height."),
        ({"bbox": [], "segmentation": {}}, "neither bbox nor segmentation"),
        ({"segmentation": {"size": [4, 4], "counts": [3, 4]}}, "add up to 7, its size is 4 x 4"),
        ({"segmentation": {"counts": [3, 4]}}, "lacks size or counts"),
        ({"segmentation": {"size": [4, 4], "counts": ""}}, "add up to 0, its size is 4 x 4"),
        ({"segmentation": {"size": [4, 4], "counts": "0"}}, "add up to 0, its size is 4 x 4"),
        ({"segmentation": {"size": [4, 4], "counts": "abc"}}, "end within a number"),
        ({"image_id": -1}, "at 0 / image_id"),
    ],
)
def test_a_bad_detection_is_named(tmp_path, change, message):
    entry = {"scene_id": 1, "image_id": 1, "category_id": 1, "score": 0.5, "bbox": [0, 0, 2, 2]} | change
    path = tmp_path / "detections.json"
    path.write_text(json.dumps([entry]))
    with pytest.raises(StepError, match=message):
        read_detections(path)


def test_a_byte_order_mark_is_skipped(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_bytes(b"\xef\xbb\xbf" + f"{HEADER}\n1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 500,1.0\n".encode())
    assert read_estimates(path).scene_ids.tolist() == [1]
    path.write_bytes(b"\xef\xbb\xbf1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 500,1.0\n")
    assert len(read_estimates(path)) == 1
