"""Test sets of BOP's own: local or hosted, all splits and forms of targets, and what is made up for where annotations are missing."""

import json
import shutil
import zipfile

import numpy as np
import pytest

from helpers.small_dataset import BOX, CAN, true_estimates
from zeroshop_steps.bop import take_test_set
from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.bop.formats.estimates import write_estimates
from zeroshop_steps.bop.formats.targets import find_targets, read_targets
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


def take(dataset, *options, models=None):
    """Run the command; the folder that it wrote into."""
    out = dataset.folder / "taken"
    places = ["--targets", out / "targets.json", "--camera", out / "camera.json", "--out", out / "test"]
    words = ["--method", "take_test_set", "--dataset", "ycbv", "--models", models or dataset.folder / "models", *places, *options]
    return stage_main("zeroshop_steps.bop", list(map(str, words))), out


def test_a_local_test_set_is_linked(dataset):
    status, out = take(dataset, "--test", dataset.folder)
    assert status == 0 and (out / "test/000001").resolve() == dataset.scenes / "000001"
    assert read_targets(out / "targets.json") == dataset.targets
    camera = read_json(out / "camera.json")
    assert (camera["width"], camera["height"], camera["fx"], camera["depth_scale"]) == (96, 72, 120.0, 0.1)


def test_missing_annotations_are_made_of_poses_and_depth(dataset):
    scene = dataset.scenes / "000001"
    before = read_scene(scene)
    masks = {(image, index): frame.mask(index) for image, frame in before.items() for index in range(len(frame.instances))}
    shutil.rmtree(scene / "mask")
    shutil.rmtree(scene / "mask_visib")
    (scene / "scene_gt_info.json").unlink()
    status, out = take(dataset, "--test", dataset.scenes)
    assert status == 0 and (out / "test/000001/rgb").resolve() == scene / "rgb"
    after = read_scene(out / "test/000001")
    for image, frame in after.items():
        for index, instance in enumerate(frame.instances):
            # 15 mm behind a surface counts as visible.
            assert instance.visible_share == pytest.approx(before[image].instances[index].visible_share, abs=0.05)
            assert (frame.mask(index) != masks[image, index]).sum() <= 0.05 * masks[image, index].sum()
            assert (frame.mask(index, "mask") >= frame.mask(index)).all()


def test_images_alone_as_of_2024_ask_for_all_objects_that_are_visible(dataset):
    (dataset.folder / "test_targets_bop19.json").unlink()
    images = [{"scene_id": 1, "im_id": 0}, {"scene_id": 1, "im_id": 1}]
    path = dataset.folder / "test_targets_bop24.json"
    path.write_text(json.dumps(images))
    found = read_targets(find_targets(dataset.scenes), dataset.scenes)
    assert [(target.im_id, target.obj_id, target.inst_count) for target in found] == [(0, BOX, 1), (0, CAN, 1), (1, BOX, 1), (1, CAN, 2)]
    with pytest.raises(StepError, match="has no obj_id"):
        read_targets(path)


def test_splits_by_sensor_and_what_is_not_clear(dataset, capsys):
    dataset.scenes.rename(dataset.folder / "test_primesense")
    assert take(dataset, "--test", dataset.folder)[0] == 0
    shutil.copytree(dataset.folder / "test_primesense", dataset.folder / "val_kinect")
    for place, words in (("", "test_primesense, val_kinect: name one"), ("models", "neither scenes nor test"), ("no", "does not exist")):
        assert take(dataset, "--test", dataset.folder / place)[0] == 1
        assert words in capsys.readouterr().err
    assert take(dataset, "--test", dataset.folder / "val_kinect")[0] == 1
    assert "val_targets_bop19.json" in capsys.readouterr().err


def test_targets_of_objects_without_a_model_are_left_out_and_counted(dataset, capsys):
    info = read_json(dataset.folder / "models/models_info.json")
    (dataset.folder / "models/models_info.json").write_text(json.dumps({str(CAN): info[str(CAN)]}))
    status, out = take(dataset, "--test", dataset.folder)
    assert status == 0 and "2 of 4 targets are left out; the dataset's objects lack [1]" in capsys.readouterr().err
    assert {target.obj_id for target in read_targets(out / "targets.json")} == {CAN}


def test_a_hosted_test_set_is_fetched_once(dataset, monkeypatch):
    hosted = dataset.folder / "hosted"
    hosted.mkdir()
    with zipfile.ZipFile(hosted / "ycbv_test_bop19.zip", "w") as opened:
        for path in dataset.scenes.rglob("*.*"):
            opened.write(path, path.relative_to(dataset.folder))
    with zipfile.ZipFile(hosted / "ycbv_base.zip", "w") as opened:
        opened.write(dataset.targets_path, "ycbv/test_targets_bop19.json")
    monkeypatch.setattr(take_test_set, "HOST", hosted.as_uri() + "/{file}")
    resources = dataset.folder / "resources"
    assert take(dataset, "--resources", resources)[0] == 0
    shutil.rmtree(hosted)
    status, out = take(dataset, "--resources", resources)
    assert status == 0 and read_targets(out / "targets.json") == dataset.targets


def test_poses_without_test_images_are_scored_without_vsd(dataset, capsys):
    for kind in ("rgb", "depth"):
        shutil.rmtree(dataset.scenes / "000001" / kind)
    (dataset.folder / "camera.json").write_text(json.dumps({"fx": 120.0, "width": 96, "height": 72}))
    _, taken = take(dataset, "--test", dataset.folder)
    write_estimates(dataset.folder / "poses.csv", true_estimates(dataset))
    words = {"estimates": "poses.csv", "models": "models", "targets": "taken/targets.json", "scenes": "taken/test"}
    options = [word for name, place in words.items() for word in (f"--{name}", str(dataset.folder / place))]
    camera = ["--camera", str(taken / "camera.json"), "--out", str(taken / "scores.csv")]
    assert stage_main("zeroshop_steps.bop", ["--method", "score_poses", *options, *camera]) == 0
    assert "VSD, and with it AR, is left out" in capsys.readouterr().err
    scores = (taken / "scores.csv").read_text()
    assert "ar_mssd,,1.0" in scores and "ar_vsd" not in scores


def test_a_real_frame_without_visibilities(shared_data, dataset):
    status, out = take(dataset, "--test", shared_data / "bop/dexycb_frame", models=shared_data / "ycbv/models")
    assert status == 0
    [frame] = read_scene(out / "test/000001").values()
    assert [instance.object_id for instance in frame.instances] == [5, 6, 13, 18]
    shares = [instance.visible_share for instance in frame.instances]
    assert np.argmin(shares) == 2 and shares[2] == pytest.approx(0.64, abs=0.03)  # the bowl, behind other things
    for index in (0, 1, 3):
        visible, silhouette = frame.mask(index), frame.mask(index, "mask")
        assert shares[index] > 0.95 and (visible & silhouette).sum() > 0.85 * silhouette.sum()
