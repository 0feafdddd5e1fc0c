"""The code that loads Grounding DINO and SAM 2, with small random ones: the same command, the same rule, and damaged files."""

import json
import shutil

import numpy as np
import pytest
import torch

from helpers.ball_scene import write_ball_scene
from helpers.small_networks import write_detector, write_tracker
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import compute_overlap, list_images, read_mask
from zeroshop_steps.networks.grounding_dino import Detector
from zeroshop_steps.networks.sam2 import ObjectTracker
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.segment import grounded_sam
from zeroshop_steps.segment.quality.mask_agreement import find_corners

CPU = torch.device("cpu")


@pytest.fixture(scope="session")
def models(tmp_path_factory):
    """resources/weights with the two small models."""
    folder = tmp_path_factory.mktemp("models")
    write_detector(folder / "small-dino")
    write_tracker(folder / "small-sam")
    return folder


@pytest.fixture
def workplace(models, tmp_path, monkeypatch):
    """A working directory with the models and a registered scene, and the true masks."""
    shutil.copytree(models, tmp_path / "resources/weights")
    masks = write_ball_scene(tmp_path / "scene")
    monkeypatch.chdir(tmp_path)
    return tmp_path, masks


def segment(*options):
    names = ["--method", "grounded_sam", "--detector", "small-dino", "--tracker", "small-sam", "--prompt", "Red ball"]
    return stage_main("zeroshop_steps.segment", [*names, "--scene", "scene", "--out", "cameras", *options])


def test_boxes_lie_in_the_image_the_best_first(models):
    image = np.random.default_rng(0).integers(0, 255, (90, 150, 3), np.uint8)
    boxes = Detector(models / "small-dino", CPU).detect(image, "Object in the middle")
    corners = np.array([box.corners_px for box in boxes])
    assert len(boxes) > 3 and (corners >= 0).all() and (corners[:, 2] <= 150).all() and (corners[:, 3] <= 90).all()
    assert (corners[:, 2:] > corners[:, :2]).all()
    assert [box.score for box in boxes] == sorted((box.score for box in boxes), reverse=True)


@pytest.mark.slow
def test_pictures_are_followed_forwards_and_backwards(models, tmp_path):
    masks = write_ball_scene(tmp_path)
    views, _ = read_views(tmp_path)
    tracker = ObjectTracker(models / "small-sam", CPU)
    boxes = {4: find_corners(masks[4]), 9: find_corners(masks[9])}
    found = tracker.follow(lambda index: views[index].image(), len(views), (160, 120), boxes)
    assert min(compute_overlap(one.mask, other) for one, other in zip(found, masks, strict=True)) > 0.8
    assert all(one.score > 0 for one in found)


@pytest.mark.slow
def test_the_command_masks_the_object(workplace, capfd):
    folder, masks = workplace
    assert segment() == 0, capfd.readouterr().err
    written = capfd.readouterr()
    assert "needs about" in written.out and "masks: 12/12" in written.err
    record = read_json(folder / "cameras/segmentation.json")
    assert record["good_masks"] == 12 and record["prompt"] == "Red ball" and record["device"] in ("cpu", "cuda")
    assert len(list_images(folder / "cameras/images")) == 12 and (folder / "cameras/contact_sheet.png").is_file()
    found = [read_mask(path) for path in list_images(folder / "cameras/masks")]
    assert min(compute_overlap(one, other) for one, other in zip(found, masks, strict=True)) > 0.8


@pytest.mark.slow
def test_the_same_pictures_give_the_same_bytes(workplace, monkeypatch):
    folder, _ = workplace
    written = []
    for threads in "14":
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        torch.set_num_threads(int(threads))
        assert segment() == 0
        written.append([path.read_bytes() for path in list_images(folder / "cameras/masks")])
    assert written[0] == written[1]


def cut_off(path):
    path.write_bytes(path.read_bytes()[:-1000])


def other_size(path):
    config = json.loads(path.read_text())
    config["mask_decoder_config"]["mlp_dim"] = 8
    path.write_text(json.dumps(config))


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("small-sam/model.safetensors", lambda path: path.unlink(), "small-sam/model.safetensors does not exist"),
        ("small-sam/model.safetensors", lambda path: path.write_bytes(b""), "small-sam/model.safetensors is empty"),
        ("small-sam/model.safetensors", cut_off, "small-sam/model.safetensors cannot be loaded"),
        ("small-sam/config.json", other_size, "damaged, cut off or of another model|lacks"),
        ("small-sam/config.json", lambda path: path.write_text("{"), "cannot be loaded"),
        ("small-dino/tokenizer.json", lambda path: path.unlink(), "small-dino/tokenizer.json does not exist"),
        ("small-dino/tokenizer.json", lambda path: path.write_text("{}"), "cannot be read"),
        ("small-dino/model.safetensors", lambda path: shutil.copy(path.parents[1] / "small-sam/model.safetensors", path), "lacks"),
    ],
)
def test_missing_or_damaged_files_are_named(workplace, capfd, file, damage, message):
    folder, _ = workplace
    damage(folder / "resources/weights" / file)
    assert segment() == 1
    error = capfd.readouterr().err
    assert any(part in error for part in message.split("|")) and "Traceback" not in error, error
    assert not (folder / "cameras").exists()


def test_published_weights_that_are_missing_say_where_to_get_them(workplace, capfd):
    assert segment("--tracker", "sam2.1-hiera-large") == 1
    error = capfd.readouterr().err
    for part in ("sam2.1-hiera-large/model.safetensors are not there", "https://", "Apache-2.0", "support_plane"):
        assert part in error


def test_too_little_memory_is_said_before_anything_is_loaded(workplace, monkeypatch, capfd):
    monkeypatch.setattr(grounded_sam, "measure_free_bytes", lambda device: 100 * 2**20)
    assert segment("--device", "cpu") == 1
    assert "MB of memory are needed on cpu, 100 MB are free; close other programs" in capfd.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_device_that_is_not_there_is_refused(workplace, capfd):
    assert segment("--device", "cuda") == 1
    assert "no CUDA device" in capfd.readouterr().err
