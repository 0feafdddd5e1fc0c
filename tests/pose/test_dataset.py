"""From detections in files to a result file: which detections are looked at, and what bad input is answered."""

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.small_dataset import BOX, CAN, dataset_in, make_dataset
from zeroshop_steps.bop.formats.detections import Detection, encode_mask, write_detections
from zeroshop_steps.bop.formats.estimates import read_estimates
from zeroshop_steps.bop.formats.targets import Target
from zeroshop_steps.pose.confidence import estimate_confidence
from zeroshop_steps.pose.dataset import choose_detections, estimate_all, run_estimator
from zeroshop_steps.runtime.cli import stage_main


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("small"))


@pytest.fixture
def small(made, tmp_path):
    shutil.copytree(made.folder, tmp_path / "data")
    return dataset_in(tmp_path / "data")


def estimated(small, *words: str) -> tuple[int, Path]:
    out = small.folder / "poses.csv"
    given = ["--models", small.folder / "models", "--scenes", small.scenes, "--targets", small.targets_path, "--out", out]
    return stage_main("zeroshop_steps.pose", ["--method", "render_compare", *map(str, given), *words]), out


@pytest.mark.slow
def test_a_dataset_is_estimated_from_its_true_masks_and_from_detections(small):
    status, out = estimated(small)
    poses = read_estimates(out)
    assert status == 0 and sorted(set(zip(poses.image_ids.tolist(), poses.object_ids.tolist(), strict=True))) == [
        (image, number) for image in (0, 1) for number in (BOX, CAN)
    ]
    assert ((poses.scores > 0) & (poses.scores < 1)).all()
    frame = small.frames[1, 0]
    write_detections(small.folder / "found.json", [Detection(1, 0, BOX, 0.7, None, encode_mask(frame.mask(0)))])
    shutil.rmtree(small.scenes / "000001/mask_visib")
    (small.scenes / "000001/scene_gt.json").unlink()
    status, out = estimated(small, "--detections", str(small.folder / "found.json"))
    found = read_estimates(out)
    assert status == 0 and len(found) == 1, "images that nobody has annotated will do"
    np.testing.assert_array_equal(found.rotations[0], poses.rotations[(poses.image_ids == 0) & (poses.object_ids == BOX)][0])


def test_a_killed_estimator_continues_with_the_next_image(small):
    """The second image ends the first run; the second run looks at that one alone, and writes what one run writes."""
    looked: list[int] = []

    def prepare(last):
        def estimator(one, mask, photo, depth, frame):
            if frame.image_id > last:
                raise KeyboardInterrupt
            looked.append(frame.image_id)
            return np.eye(4) * (1, 1, 1, 1) + frame.image_id / 3, 0.1 * one.object_id

        return estimator

    def run(last, out):
        args = argparse.Namespace(
            models=small.folder / "models", scenes=small.scenes, targets=small.targets_path, detections=None, out=small.folder / out
        )
        run_estimator(args, lambda models: prepare(last))
        return [line.rpartition(",")[0] for line in args.out.read_text().splitlines()]

    with pytest.raises(KeyboardInterrupt):
        run(0, "poses.csv")
    assert set(looked) == {0}
    looked.clear()
    found = run(1, "poses.csv")
    assert set(looked) == {1} and found == run(1, "whole.csv") and not list(small.folder.glob(".*.partial"))


def test_the_surest_detections_of_a_target_are_looked_at():
    mask = encode_mask(np.ones((4, 4), bool))
    found = [Detection(1, 0, number, score, None, mask) for number in (BOX, CAN) for score in (0.1, 0.9, 0.5, 0.7)]
    chosen = choose_detections(found, [Target(1, 0, BOX, 1), Target(1, 1, BOX, 1)], [BOX], 1, Path("found.json"))
    assert [(one.object_id, one.score) for one in chosen] == [(BOX, 0.9), (BOX, 0.7)]


@pytest.mark.parametrize(("sure", "tried"), [(None, 2), (0.3, 2), (0.8, 3)])
def test_parts_that_touch_are_tried_as_one_where_no_pose_is_sure(small, sure, tried):
    whole = small.frames[1, 0].mask(0)
    upper = whole & (np.cumsum(whole.any(1)) <= whole.any(1).sum() // 2)[:, None]
    parts = [Detection(1, 0, BOX, score, None, encode_mask(mask)) for score, mask in ((0.9, upper), (0.4, whole & ~upper))]

    def seen_share(detection, mask, *rest):
        return np.eye(4), 0.9 * mask.sum() / whole.sum()

    found = estimate_all(parts, small.frames, seen_share, sure)
    assert len(found) == tried
    assert (found.scores.max() == pytest.approx(0.9)) == (tried == 3)


def test_no_detections_give_no_estimates(small):
    (small.folder / "found.json").write_text("[]")
    status, out = estimated(small, "--detections", str(small.folder / "found.json"))
    assert status == 0 and len(read_estimates(out)) == 0


def test_an_object_without_a_model_is_warned_of_and_none_at_all_refused(small, capsys):
    listed = json.loads((small.folder / "models/models_info.json").read_text())
    (small.folder / "models/models_info.json").write_text(json.dumps({key: listed[key] for key in [str(CAN)]}))
    (small.folder / "found.json").write_text("[]")
    assert estimated(small, "--detections", str(small.folder / "found.json"))[0] == 0
    assert f"no model of the objects [{BOX}]" in capsys.readouterr().err
    (small.folder / "models/models_info.json").write_text("{}")
    assert estimated(small, "--detections", str(small.folder / "found.json"))[0] == 1
    assert "of which" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda scene: shutil.rmtree(scene / "rgb"), "has no image 000000"),
        (lambda scene: shutil.rmtree(scene / "depth"), "poses are estimated from depth: add it"),
        (lambda scene: shutil.rmtree(scene / "mask_visib"), "has no 000000_000000.png, the mask of an instance"),
        (lambda scene: (scene / "scene_gt.json").unlink(), "scene_gt.json"),
    ],
)
def test_what_is_missing_is_named(small, capsys, damage, message):
    damage(small.scenes / "000001")
    status, out = estimated(small)
    assert status == 1 and message in capsys.readouterr().err and not out.exists()


def test_masks_of_another_size_and_detections_without_masks_are_refused(small, capsys):
    path = small.folder / "found.json"
    write_detections(path, [Detection(1, 0, BOX, 0.7, None, encode_mask(np.ones((10, 10), bool)))])
    assert estimated(small, "--detections", str(path))[0] == 1 and "is 10 x 10 px, the image 96 x 72 px" in capsys.readouterr().err
    write_detections(path, [Detection(1, 0, BOX, 0.7, (1, 1, 5, 5), None)])
    assert estimated(small, "--detections", str(path))[0] == 1 and "has no segmentation; poses need masks" in capsys.readouterr().err


def test_confidence_grows_with_what_speaks_for_a_pose():
    assert estimate_confidence(0.9, 0.1, 1000) > estimate_confidence(0.6, 0.1, 1000) > estimate_confidence(0.35, 0.0, 1000)
    assert estimate_confidence(0.9, 0.1, 1000) > estimate_confidence(0.9, 0.0, 1000)
    assert estimate_confidence(0.95, 0.2, 1000) > 0.95 and estimate_confidence(0.4, 0.01, 5000) < 0.1
