"""CNOS with small random networks: the same command and files as with the published ones, whose weights no test has."""

import shutil

import numpy as np
import pytest
import torch

from helpers.painted_scene import CAN, CARTON, detect
from helpers.small_detectors import save_fastsam
from zeroshop_steps import methods
from zeroshop_steps.bop.formats.detections import decode_mask, read_detections
from zeroshop_steps.detect.cnos import assign_objects, describe_views, score_objects
from zeroshop_steps.detect.cnos.crops import CropDescriber, crop_masked
from zeroshop_steps.detect.cnos.segment_anything import SegmentAnything, drop_duplicate_masks, drop_small_masks, measure_stability
from zeroshop_steps.detect.templates import read_templates
from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.networks.imagenet import DEVIATION, MEAN
from zeroshop_steps.runtime.cli import stage_methods


@pytest.mark.slow
def test_the_command_writes_what_random_networks_find(dataset, weights):
    options = ("--points-per-side", "4", "--least-iou", "0.5", "--least-stability", "0.3", "--width-px", "160", "--device", "cpu")
    assert detect(dataset, "cnos", *options) == 0
    found = read_detections(dataset.folder / "detections.json")
    assert {one.object_id for one in found} <= {CARTON, CAN} and {one.image_id for one in found} == {0, 1}
    assert all(0.01 < one.score <= 1 and decode_mask(one.mask).shape == (240, 320) for one in found)
    assert detect(dataset, "cnos", *options[:3], "2.0", *options[4:]) == 0
    assert read_detections(dataset.folder / "detections.json") == [], "no mask is that sure"


@pytest.mark.slow
def test_regions_come_from_fastsam_where_it_is_asked_for(dataset, weights, capsys):
    assert detect(dataset, "cnos", "--proposals", "fastsam") == 1
    assert "FastSAM-x.pt are not there" in capsys.readouterr().err
    save_fastsam(weights)
    shutil.rmtree(dataset.scene / "depth")
    assert detect(dataset, "cnos", "--proposals", "fastsam", "--width-px", "160", "--device", "cpu") == 0
    found = read_detections(dataset.folder / "detections.json")
    assert found and all(decode_mask(one.mask).shape == (240, 320) for one in found)


def test_without_weights_it_says_how_to_get_them(dataset, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert detect(dataset, "cnos") == 1
    message = capsys.readouterr().err
    assert "sam-vit-huge/config.json are not there" in message and "contour needs no weights" in message
    reason = methods.refusal("detector", "cnos", methods.DETECTORS, tmp_path)
    assert "sam-vit-huge/model.safetensors" in reason and "Those that can: contour" in reason
    assert {"contour", "cnos"} <= set(methods.DETECTORS) & set(stage_methods("zeroshop_steps.detect"))


def test_damaged_weights_are_named(dataset, weights, capsys):
    (weights / "dinov2-large" / "model.safetensors").write_bytes(b"damaged")
    assert detect(dataset, "cnos") == 1
    assert "dinov2-large/model.safetensors cannot be loaded" in capsys.readouterr().err


@pytest.mark.slow
def test_a_cut_out_view_is_named_as_its_object(dataset, weights):
    """Even random tokens tell red boxes from green cans, where masks are true."""
    describer = CropDescriber(weights / "dinov2-large", torch.device("cpu"))
    views = {number: describe_views(read_templates(dataset.folder / "templates", number), describer) for number in (CARTON, CAN)}
    assert all(vectors.shape == (42, 32) for vectors in views.values())
    np.testing.assert_allclose(np.linalg.norm(views[CAN], axis=1), 1, atol=1e-5)
    photo = read_image(dataset.scene / "rgb" / "000000.png")
    masks = [read_mask(dataset.scene / "mask_visib" / f"000000_{index:06d}.png") for index in (0, 1)]
    found = assign_objects([*masks, np.zeros_like(masks[0]), masks[1]], photo, describer, views)
    assert [(one.object_id, one.mask.sum()) for one in found] == [(CARTON, masks[0].sum()), (CAN, masks[1].sum())], "doubles go"


def test_the_score_is_the_mean_of_the_five_nearest_views():
    angles = np.radians([0, 10, 20, 30, 40, 90, 120])
    views = np.stack([np.cos(angles), np.sin(angles)], 1).astype(np.float32)
    scores = score_objects(np.array([[1.0, 0.0]], np.float32), [views, -views])
    np.testing.assert_allclose(scores[0, 0], np.cos(angles[:5]).mean(), atol=1e-6)
    np.testing.assert_allclose(scores[0, 1], 0.5 / 5, atol=1e-6)


def test_crops_show_the_region_alone_in_the_middle_of_a_square():
    image = np.full((60, 100, 3), 255, np.uint8)
    mask = np.zeros((60, 100), bool)
    mask[10:30, 20:60] = True
    mask[10:20, 20:40] = False
    crop = crop_masked(image, mask)
    black, white = ((level - np.array(MEAN)) / DEVIATION for level in (0, 1))
    assert crop.shape == (3, 224, 224)
    for row, column, color in ((50, 112, black), (60, 20, black), (60, 200, white), (160, 20, white), (175, 112, black)):
        np.testing.assert_allclose(crop[:, row, column], color, atol=1e-5)


def test_masks_with_vague_borders_are_not_stable():
    steps = torch.linspace(-10, 10, 101)
    sharp, vague = torch.where(steps > 0, 10.0, -10.0), steps
    values = measure_stability(torch.stack([sharp, vague, torch.full((101,), -9.0)])[:, None])
    np.testing.assert_allclose(values, [1.0, 45 / 55, 0.0], atol=0.02)


def test_doubles_and_specks_go():
    masks = [np.zeros((100, 100), bool) for _ in range(4)]
    masks[0][10:50, 10:50] = masks[1][10:50, 10:48] = masks[2][60:63, 60:63] = True
    kept = drop_duplicate_masks(masks, np.array([0.9, 0.95, 0.8, 1.0]))
    assert [mask.sum() for mask in kept] == [masks[1].sum(), 9]
    assert [mask.sum() for mask in drop_small_masks(kept)] == [masks[1].sum()]


def test_points_lie_on_the_image_and_not_on_its_padding(weights):
    """A network that answers with its own prompts: the grid spans the image's part of the square."""
    segmenter = SegmentAnything(weights / "sam-vit-huge", torch.device("cpu"))
    asked = []
    original = segmenter._model.forward

    def watched(**inputs):
        asked.append(inputs["input_points"])
        return original(**inputs)

    segmenter._model.forward = watched
    segmenter.segment(np.zeros((50, 100, 3), np.uint8), points_per_side=4, least_iou=9.0, least_stability=0.9)
    points = torch.cat(asked, 1).reshape(-1, 2).numpy()
    assert len(points) == 16
    np.testing.assert_allclose(points.min(0), [16, 8])
    np.testing.assert_allclose(points.max(0), [112, 56])
