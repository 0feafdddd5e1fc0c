"""A salient-object network gives the prior: what photos agree on counts, and the file is refused with its name where it is none."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from helpers.ball_scene import ball_cameras, ball_mask, write_ball_scene
from helpers.small_saliency import DEVIATION, MEAN, NORMALIZATION, write_network
from zeroshop_steps.geometry.imaging.images import compute_overlap, list_images, read_mask, write_image
from zeroshop_steps.networks.saliency.object_finder import cut_main_things, keep_main_thing
from zeroshop_steps.networks.saliency.salient_object import SalientObjectNetwork
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json
from zeroshop_steps.segment.quality.mask_agreement import render_common_hull

OTHER = (1.3, 0.9, 0.2)


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    masks = write_ball_scene(tmp_path / "scene")
    write_network(tmp_path / "saliency.onnx")
    monkeypatch.chdir(tmp_path)
    return tmp_path, masks


def segment(*options):
    names = ["--method", "saliency", "--network", "saliency.onnx", *NORMALIZATION, "--scene", "scene", "--out", "cameras"]
    return stage_main("zeroshop_steps.segment", [*names, *options])


@pytest.mark.slow
def test_the_object_is_found_where_there_is_no_ground(workplace):
    folder, masks = workplace
    assert segment() == 0
    record = read_json(folder / "cameras/segmentation.json")
    assert record["method"] == "saliency" and record["good_masks"] == 12 and record["network"] == "saliency.onnx"
    assert record["plane_from"] == "object" and record["probability"] > 0.5
    for path, truth in zip(list_images(folder / "cameras/images"), masks, strict=True):
        found = read_mask(folder / "cameras/masks" / f"{path.stem}.png", truth.shape[::-1])
        assert compute_overlap(found, truth) > 0.93


def test_a_part_that_a_few_photos_lack_is_kept():
    """A knob beside the ball: a strict hull of all photos has none where three of twelve do not show it."""
    cameras = ball_cameras()
    knob = [ball_mask(camera, (0.68, 0.0, 0.0), 0.2) for camera in cameras]
    balls = [ball_mask(camera) for camera in cameras]
    beside = [part & ~ball for part, ball in zip(knob, balls, strict=True)]
    lacking = np.argsort([part.sum() for part in beside])[-8::3]
    masks = [ball if index in lacking else ball | part for index, (ball, part) in enumerate(zip(balls, knob, strict=True))]
    hulls = render_common_hull(cameras, masks)
    shares = [hull[part].mean() for hull, part in zip(hulls, beside, strict=True) if part.sum() > 20]
    assert len(shares) > 6 and np.mean(shares) > 0.6, shares
    whole = [ball | part for ball, part in zip(balls, knob, strict=True)]
    assert np.median([compute_overlap(hull, truth) for hull, truth in zip(hulls, whole, strict=True)]) > 0.88


def test_photos_without_cameras_are_masked(workplace):
    folder, masks = workplace
    (folder / "scene/capture.json").write_text("{}")
    names = ["--method", "object_capture", "--pictures", "scene", "--capture", "scene", "--out", "object"]
    options = ["--segmentation", "saliency", "--options", "--network", "saliency.onnx", *NORMALIZATION]
    assert stage_main("zeroshop_steps.segment", [*names, *options]) == 0
    assert read_json(folder / "object/segmentation.json")["good_masks"] == 12
    found = read_mask(folder / "object/masks" / f"{list_images(folder / 'object/images')[3].stem}.png", masks[3].shape[::-1])
    assert compute_overlap(found, masks[3]) > 0.95


def test_of_several_things_the_one_in_the_middle_and_its_parts_are_kept():
    found = np.zeros((90, 160), np.float32)
    main, part, other = (slice(30, 60), slice(60, 95)), (slice(61, 68), slice(70, 80)), (slice(10, 40), slice(4, 40))
    for thing in (main, part, other):
        found[thing] = 1.0
    kept = keep_main_thing(found)
    assert kept[main].all() and kept[part].all() and not kept[other].any()


def test_values_before_the_sigmoid_mean_the_same(workplace):
    folder, _ = workplace
    write_network(folder / "raw.onnx", sigmoid=False)
    image = np.full((30, 40, 3), 90, np.uint8)
    image[8:20, 10:30] = (200, 30, 30)
    [sure, raw] = [SalientObjectNetwork(folder / name, MEAN, DEVIATION).predict(image, (40, 30)) for name in ("saliency.onnx", "raw.onnx")]
    assert sure.shape == (30, 40) and np.allclose(sure, raw, atol=1e-5)
    assert (sure[10:18, 12:28] > 0.9).all() and (sure[:6] < 0.1).all()


def test_shares_that_rounding_lifts_above_one_are_no_values_before_the_sigmoid(workplace, monkeypatch):
    """IS-Net gives 1.0000001 now and then: taken for a value before the sigmoid, no pixel was below a half."""
    network = SalientObjectNetwork(workplace[0] / "saliency.onnx", MEAN, DEVIATION)
    answer = np.zeros((1, 1, 30, 40), np.float32)
    answer[..., 8:20, 10:30] = np.nextafter(np.float32(1), np.float32(2))
    monkeypatch.setattr(network, "_session", SimpleNamespace(run=lambda *_: [answer]))
    found = network.predict(np.full((30, 40, 3), 90, np.uint8), (40, 30))
    assert found.min() == 0.0 and found.max() == 1.0


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "does not exist; segment.saliency.network (--network) is the ONNX file"),
        (lambda path: path.write_bytes(b"not a network"), "cannot be read as an ONNX network"),
        (lambda path: write_network(path, channels=1), "expected one float image of 1 x 3 x height x width"),
        (lambda path: write_network(path, outputs=2), "expected one map"),
    ],
)
def test_what_is_no_such_network_is_named(workplace, capfd, damage, message):
    folder, _ = workplace
    damage(folder / "saliency.onnx")
    assert segment() == 1
    error = capfd.readouterr().err
    assert message in error and "saliency.onnx" in error and "Traceback" not in error
    assert not (folder / "cameras").exists()


def test_a_closer_look_sees_a_small_thing_finer(workplace, monkeypatch):
    """To a network of 128 pixels, a photo of 1200 shows outlines to ten pixels. What fills the photo is looked at once."""
    folder, _ = workplace
    network = SalientObjectNetwork(folder / "saliency.onnx", MEAN, DEVIATION)
    small, large = np.zeros((900, 1200), np.uint8), np.zeros((900, 1200), np.uint8)
    cv2.ellipse(small, (600, 450), (110, 70), 30, 0, 360, 1, -1)
    large[40:860, 60:1100] = 1
    paths = [folder / "small.png", folder / "large.png"]
    for path, shown in zip(paths, (small, large), strict=True):
        write_image(path, np.where(shown[..., None] > 0, (220, 30, 30), (90, 90, 90)).astype(np.uint8))
    maps = network.find_maps(paths, 480)
    closer = network.look_closer(paths, maps, 1000)
    before, after = (compute_overlap(mask, small > 0) for mask in cut_main_things([maps[0], closer[0]], [(1200, 900)] * 2))
    assert closer[0].shape == (750, 1000) and 1 - after < 0.7 * (1 - before), (before, after)
    assert closer[1] is maps[1]
    empty = np.zeros_like(maps[0])
    assert network.look_closer(paths[:1], [empty], 1000)[0] is empty
    predict = network.predict
    monkeypatch.setattr(network, "predict", lambda image, size_px: predict(image, size_px) * (np.arange(size_px[0]) > size_px[0] / 2))
    assert network.look_closer(paths[:1], maps[:1], 1000)[0] is maps[0], "from closer, half of it is missing"
