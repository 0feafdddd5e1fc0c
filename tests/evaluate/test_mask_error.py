"""Masks are judged by the true ones of the frames they were taken from, through the lens that was found."""

import csv

import numpy as np
import pytest

from zeroshop_steps.evaluate.mask_error import intersection_over_union, undistort_mask
from zeroshop_steps.geometry.imaging.images import read_image, write_image, write_mask
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, read_failure, write_failure
from zeroshop_steps.runtime.files import write_json

SHAPE = (60, 80)


def disc(radius: float, x: float = 40.0, y: float = 30.0) -> np.ndarray:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    return (columns - x) ** 2 + (rows - y) ** 2 < radius**2


@pytest.fixture
def judged(tmp_path):
    """Frames 5, 9 and 2 of a film: the first mask right, the second half as large, the third left out."""
    for number, radius in ((5, 10), (9, 20), (2, 15)):
        write_mask(tmp_path / "truth" / "masks" / f"{number:06d}.png", disc(radius))
    for index, radius in ((0, 10), (1, 20 / np.sqrt(2))):
        write_image(tmp_path / "cameras" / "images" / f"{index:06d}.png", np.full((*SHAPE, 3), 90, np.uint8))
        write_mask(tmp_path / "cameras" / "masks" / f"{index:06d}.png", disc(radius))
    write_json(tmp_path / "cameras" / "registration.json", {"status": "ok", "lens": None})
    write_json(tmp_path / "capture" / "capture.json", {"source_frames": [5, 9, 2]})

    def judge(*more: str) -> int:
        words = ["--method", "mask_error", "--out", tmp_path / "mask_error.csv", *more]
        words += [word for part in ("cameras", "capture", "truth") for word in (f"--{part}", tmp_path / part)]
        return stage_main("zeroshop_steps.evaluate", [str(word) for word in words])

    return judge, tmp_path


def test_each_frame_is_compared_with_its_own_true_mask(judged):
    judge, folder = judged
    assert judge() == 0
    with (folder / "mask_error.csv").open(newline="") as file:
        values = {(row["camera"], row["measure"]): row["value"] for row in csv.DictReader(file)}
    assert float(values["000000", "iou"]) == 1.0
    assert float(values["000001", "iou"]) == pytest.approx(0.5, abs=0.03)
    assert values["000002", "iou"] == ""
    assert (values["all", "masks"], values["all", "left_out"]) == ("2", "1")
    assert float(values["all", "iou_min"]) == float(values["000001", "iou"])


def test_the_picture_shows_the_worst_first_and_what_it_lacks_in_green(judged):
    judge, folder = judged
    judge()
    tiles = read_image(folder / "mask_error.png")
    green = (tiles[..., 1].astype(int) - tiles[..., 0]) > 60
    assert green[:, :320].mean() > 0.2 and not green[:, 320:640].any()
    assert not (tiles[..., 0].astype(int) - tiles[..., 1] > 60).any()


def test_a_failed_segmentation_is_a_row_with_its_reason(judged):
    judge, folder = judged
    write_failure([f"{folder}/cameras/"], Failure("segment.support_plane", "nothing stands there"))
    assert judge("--record-failure", str(folder / "mask_error.csv")) == 0
    assert "nothing stands there" in read_failure(folder / "mask_error.csv").reason


def test_photos_cannot_be_judged(judged, capsys):
    judge, folder = judged
    write_json(folder / "capture" / "capture.json", {"images": 3})
    assert judge() == 1
    assert "source_frames" in capsys.readouterr().err


def test_the_true_mask_goes_through_the_lens():
    lens = {"model": "SIMPLE_RADIAL", "width_px": 80, "height_px": 60, "params": [70.0, 40.0, 30.0, -0.2]}
    mask = disc(5, x=66)
    moved = undistort_mask(mask, lens)
    assert np.argwhere(moved)[:, 1].mean() > np.argwhere(mask)[:, 1].mean() + 0.5  # a barrel lens drew it inwards
    assert intersection_over_union(undistort_mask(mask, None), mask) == 1.0
