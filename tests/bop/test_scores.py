"""Perfect poses score 1, random ones nearly 0, those turned by a symmetry 1; the commands work on files."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.small_dataset import BOX, CAN, true_estimates
from zeroshop_steps.bop.formats.detections import Detection, encode_mask, mask_to_box, read_detections, write_detections
from zeroshop_steps.bop.formats.estimates import write_estimates
from zeroshop_steps.bop.scoring.precision import average_precision
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError


def score(dataset, estimates, *options) -> dict[tuple[str, str], float]:
    """Run the command; the values by measure and object."""
    write_estimates(dataset.folder / "poses.csv", estimates)
    return run(dataset, ["--method", "score_poses", "--estimates", "poses.csv", "--models", "models", *options])


def file_words(dataset, words) -> list[str]:
    """The command line with the dataset's paths; scores go to scores.csv."""
    words = [str(dataset.folder / word) if word in ("poses.csv", "models", "detections.json") else word for word in words]
    out = str(dataset.folder / "scores.csv")
    return [*words, "--targets", str(dataset.targets_path), "--scenes", str(dataset.scenes), "--out", out]


def run(dataset, words) -> dict[tuple[str, str], float]:
    assert stage_main("zeroshop_steps.bop", file_words(dataset, words)) == 0
    with (dataset.folder / "scores.csv").open() as file:
        return {(row["measure"], row["object"]): float(row["value"]) for row in csv.DictReader(file)}


def test_perfect_poses_score_one(dataset):
    scores = score(dataset, true_estimates(dataset), "--errors-out", str(dataset.folder / "errors.csv"))
    for measure in ("ar", "ar_vsd", "ar_mssd", "ar_mspd"):
        assert scores[measure, ""] == scores[measure, str(BOX)] == scores[measure, str(CAN)] == 1.0
    assert scores["instances", ""] == 4 and scores["seconds_per_image", ""] == 0.5
    with (dataset.folder / "errors.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and all(float(row["mssd"]) < 1e-9 and float(row["vsd"]) < 0.02 for row in rows)


def test_poses_turned_by_a_symmetry_score_one(dataset):
    estimates = true_estimates(dataset)
    turned = estimates.rotations @ Rotation.from_rotvec([0, 0, 1.234]).as_matrix()
    cans = estimates.object_ids == CAN
    scores = score(dataset, replace(estimates, rotations=np.where(cans[:, None, None], turned, estimates.rotations)))
    assert scores["ar", ""] == 1.0
    scores = score(dataset, replace(estimates, rotations=turned))
    assert scores["ar", str(CAN)] == 1.0 and scores["ar_mssd", str(BOX)] < 0.5


def test_random_poses_score_almost_nothing(dataset):
    estimates = true_estimates(dataset)
    rng = np.random.default_rng(1)
    wild = Rotation.from_quat(rng.normal(size=(len(estimates), 4))).as_matrix()
    places = estimates.translations_mm + rng.normal(0, 120, (len(estimates), 3))
    assert score(dataset, replace(estimates, rotations=wild, translations_mm=places))["ar", ""] < 0.1


def test_only_as_many_estimates_count_as_instances_are_asked_for(dataset):
    estimates = true_estimates(dataset)
    wrong = replace(estimates, translations_mm=estimates.translations_mm + [200.0, 0, 0], scores=estimates.scores + 10)
    both = replace(
        estimates,
        **{name: np.concatenate([getattr(estimates, name), getattr(wrong, name)]) for name in vars(estimates)},
    )
    assert score(dataset, both)["ar", ""] < 0.3, "the surer estimates are the wrong ones"
    turned = np.where(both.scores < 10, both.scores + 20, both.scores)
    assert score(dataset, replace(both, scores=turned))["ar", ""] == 1.0


def test_without_estimates_everything_is_missed(dataset):
    estimates = true_estimates(dataset)
    none = replace(estimates, **{name: getattr(estimates, name)[:0] for name in vars(estimates)})
    scores = score(dataset, none, "--errors-out", str(dataset.folder / "errors.csv"))
    assert scores["ar", ""] == 0.0 and scores["seconds_per_image", ""] == -1.0
    head, *rows = (dataset.folder / "errors.csv").read_text().splitlines()
    assert head == "scene_id,im_id,obj_id,estimate,score,instance,vsd,mssd,mspd" and not rows


def test_unknown_objects_are_refused(dataset, capsys):
    estimates = true_estimates(dataset)
    write_estimates(dataset.folder / "poses.csv", replace(estimates, object_ids=estimates.object_ids + 7))
    words = ["--method", "score_poses", "--estimates", str(dataset.folder / "poses.csv"), "--models", str(dataset.folder / "models")]
    words += ["--targets", str(dataset.targets_path), "--scenes", str(dataset.scenes), "--out", str(dataset.folder / "scores.csv")]
    assert stage_main("zeroshop_steps.bop", words) == 1
    assert "[8, 9], which have no model" in capsys.readouterr().err and not (dataset.folder / "scores.csv").exists()


def true_detections(dataset) -> list[Detection]:
    found = []
    for frame in dataset.frames.values():
        for index, instance in enumerate(frame.instances):
            mask, box = frame.mask(index), mask_to_box(frame.mask(index, "mask"))
            found.append(Detection(frame.scene_id, frame.image_id, instance.object_id, 0.9, box, encode_mask(mask), 0.1))
    return found


@pytest.mark.parametrize(("of", "ap"), [("masks", "ap"), ("boxes", "box_ap")])
def test_true_detections_score_one_and_shifted_ones_less(dataset, of, ap):
    found = true_detections(dataset)
    write_detections(dataset.folder / "detections.json", found)
    words = ["--method", "score_detections", "--detections", "detections.json", "--of", of]
    scores = run(dataset, words)
    assert scores[ap, ""] == scores[ap, str(BOX)] == 1.0 and scores["detections", ""] == 5
    shifted = [
        replace(one, box_px=(one.box_px[0] + 4, *one.box_px[1:]), mask=encode_mask(np.roll(dataset.frames[1, one.image_id].mask(0), 4, 1)))
        for one in found
    ]
    write_detections(dataset.folder / "detections.json", shifted)
    assert run(dataset, words)[ap, ""] < 0.7
    write_detections(dataset.folder / "detections.json", [])
    both = run(dataset, [*words, "masks"])
    assert both["ap", ""] == both[ap, ""] == 0.0


@pytest.mark.parametrize(("box", "modal"), [("bbox_obj", []), ("bbox_visib", ["--modal-boxes"])])
def test_boxes_are_scored_without_masks(dataset, box, modal):
    """Where there are no masks, true boxes are those of scene_gt_info.json."""
    truth = [instance for frame in dataset.frames.values() for instance in frame.instances]
    found = [replace(one, box_px=tuple(instance.info[box])) for one, instance in zip(true_detections(dataset), truth, strict=True)]
    write_detections(dataset.folder / "detections.json", found)
    for kind in ("mask", "mask_visib"):
        shutil.rmtree(dataset.scenes / "000001" / kind)
    words = ["--method", "score_detections", "--detections", "detections.json", "--of"]
    assert run(dataset, [*words, "boxes", *modal])["box_ap", ""] == 1.0
    write_detections(dataset.folder / "detections.json", [replace(one, box_px=(0, 0, 9, 9)) for one in found])
    assert run(dataset, [*words, "boxes", *modal])["box_ap", ""] == 0.0
    assert stage_main("zeroshop_steps.bop", file_words(dataset, [*words, "masks"])) != 0


def test_a_mask_of_another_size_is_refused(dataset):
    first, *others = true_detections(dataset)
    write_detections(dataset.folder / "detections.json", [replace(first, mask=encode_mask(np.ones((5, 4), bool))), *others])
    with pytest.raises(StepError, match="is 4 x 5 px, image"):
        average_precision(read_detections(dataset.folder / "detections.json"), dataset.frames, "segm", True, Path("detections.json"))


def test_a_real_submission_scores_as_bop_toolkit_says(shared_data, tmp_path):
    """35 instances of YCB-V; both numbers were computed by bop_toolkit from the same files (bop_reference_cases.py names its version)."""
    (tmp_path / "test").mkdir()
    source = shared_data / "bop" / "ycbv_scene48"
    shutil.copytree(source, tmp_path / "test" / "000048")
    submission = next((shared_data / "bop" / "scoring").glob("cnos-fastsammegapose_ycbv*.csv"))
    words = ["--method", "score_poses", "--estimates", str(submission), "--errors", "mssd", "mspd", "--image-width", "640"]
    words += ["--targets", str(source / "test_targets_scene48_subset.json"), "--models", str(shared_data / "ycbv" / "models")]
    words += ["--scenes", str(tmp_path / "test"), "--out", str(tmp_path / "scores.csv")]
    assert stage_main("zeroshop_steps.bop", words) == 0
    with (tmp_path / "scores.csv").open() as file:
        scores = {row["measure"]: float(row["value"]) for row in csv.DictReader(file) if not row["object"]}
    assert scores["ar_mssd"] == pytest.approx(0.3371428571428571, abs=1e-9)
    assert scores["ar_mspd"] == pytest.approx(0.47714285714285715, abs=1e-9)
    assert scores["instances"] == 35 and "ar" not in scores


def test_a_real_frame_scores_one_against_its_own_truth(shared_data, tmp_path):
    folder = shared_data / "bop" / "dexycb_frame"
    truth = json.loads((folder / "test/000001/scene_gt.json").read_text())["0"]
    rows = [f"1,0,{e['obj_id']},1,{' '.join(map(str, e['cam_R_m2c']))},{' '.join(map(str, e['cam_t_m2c']))},-1" for e in truth]
    (tmp_path / "poses.csv").write_text("\n".join(rows))
    words = ["--method", "score_poses", "--estimates", str(tmp_path / "poses.csv"), "--models", str(shared_data / "ycbv" / "models")]
    words += ["--targets", str(folder / "test_targets_bop19.json"), "--scenes", str(folder / "test"), "--out", str(tmp_path / "scores.csv")]
    assert stage_main("zeroshop_steps.bop", words) == 0
    with (tmp_path / "scores.csv").open() as file:
        scores = {row["measure"]: float(row["value"]) for row in csv.DictReader(file) if not row["object"]}
    assert scores["ar"] == 1.0
