"""Pictures and masks become a capture that is registered by the object alone, whoever found the masks."""

import shutil

import numpy as np
import pytest

from helpers.ball_scene import ball_cameras, write_ball_scene
from helpers.small_networks import write_detector, write_tracker
from zeroshop_steps.capture.cameras_json import GivenCamera, GivenCameras, Lens, read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.geometry.imaging.images import compute_overlap, list_images, read_mask, write_mask
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.failures import Failure, write_failure
from zeroshop_steps.runtime.files import read_json, write_json


@pytest.fixture
def pictures(tmp_path, monkeypatch):
    """A capture of a ball without masks, and the true ones."""
    masks = write_ball_scene(tmp_path / "capture")
    shutil.rmtree(tmp_path / "capture/sparse")
    (tmp_path / "capture/registration.json").unlink()
    facts = {"scene": "video", "images": 12, "source_names": [f"IMG_{k}.jpg" for k in range(12)]}
    write_json(tmp_path / "capture/capture.json", facts)
    monkeypatch.chdir(tmp_path)
    return tmp_path, masks


def object_capture(source, *options):
    names = ["--method", "object_capture", "--pictures", source, "--capture", "capture", "--out", "object"]
    return stage_main("zeroshop_steps.segment", [*names, *options])


def test_given_masks_are_taken(pictures):
    folder, masks = pictures
    for path, mask in zip(list_images(folder / "capture/images"), masks, strict=True):
        write_mask(folder / "capture/masks" / f"{path.stem}.png", mask)
    assert object_capture("capture") == 0
    assert len(read_image_set(folder / "object").masks) == 12
    facts = read_json(folder / "object/capture.json")
    assert facts["scene"] == "video_segmented" and facts["source_names"][3] == "IMG_3.jpg"


def test_given_cameras_go_along_with_the_pictures_that_stay(pictures):
    """Those of photos as they are keep their lenses; those of a registered scene have its lens, without distortion."""
    folder, masks = pictures
    paths = list_images(folder / "capture/images")
    for path, mask in zip(paths, masks, strict=True):
        write_mask(folder / "capture/masks" / f"{path.stem}.png", mask)
    lens = Lens("SIMPLE_RADIAL", *masks[0].shape[::-1], (100.0, 80.0, 60.0, 0.1))
    pose = np.eye(4)
    GivenCameras({f"{path.stem}.jpg": GivenCamera(lens, pose) for path in paths}, "an arm").write(folder / "capture/cameras.json")
    assert object_capture("capture") == 0
    given = read_given_cameras(folder / "object/cameras.json")
    assert list(given.images) == [path.name for path in paths] and given.source == "an arm" and given.has_poses
    assert all(one.lens == lens for one in given.images.values())
    assert set(read_image_set(folder / "object").lenses) == {path.stem for path in paths}
    write_cameras(folder / "capture/sparse", ball_cameras())
    assert object_capture("capture") == 0
    given = read_given_cameras(folder / "object/cameras.json")
    assert {one.lens.model for one in given.images.values()} == {"PINHOLE"} and given.has_poses


@pytest.mark.slow
def test_networks_find_masks_where_there_are_none(pictures, capfd):
    folder, masks = pictures
    write_detector(folder / "resources/weights/small-dino")
    write_tracker(folder / "resources/weights/small-sam")
    names = ["--segmentation", "grounded_sam", "--options", "--detector", "small-dino", "--tracker", "small-sam", "--seed", "0"]
    assert object_capture("capture", *names) == 0, capfd.readouterr().err
    found = [read_mask(path) for path in list_images(folder / "object/masks")]
    assert len(found) == 12 and min(compute_overlap(one, other) for one, other in zip(found, masks, strict=True)) > 0.8
    record = read_json(folder / "object/segmentation.json")
    assert record["method"] == "grounded_sam" and record["median_disagreement"] is None


def test_a_failed_registration_passes_its_reason_on(pictures, capfd):
    folder, _ = pictures
    write_failure([f"{folder}/cameras/"], Failure("register.colmap", "3 of 12 images registered"))
    assert object_capture("cameras") == 1
    assert "3 of 12 images registered" in capfd.readouterr().err and not (folder / "object").exists()


def test_masks_of_another_size_are_refused(pictures, capfd):
    folder, _ = pictures
    for path in list_images(folder / "capture/images"):
        write_mask(folder / "capture/masks" / f"{path.stem}.png", np.ones((10, 10), bool))
    assert object_capture("capture") == 1
    assert "they must be equal" in capfd.readouterr().err
