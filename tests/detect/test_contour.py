"""The contour detector finds the objects and nothing else, and says what is wrong with its input."""

import argparse
import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from helpers.painted_scene import CAN, CARTON, detect
from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.bop.formats.detections import decode_mask, read_detections
from zeroshop_steps.bop.formats.models import read_models
from zeroshop_steps.detect.contour import discount_explained, prepare
from zeroshop_steps.detect.contour.depth_surface import find_ground, prepare_surface
from zeroshop_steps.detect.detector_io import ObjectMask, read_frames, run_detector, suppress_boxes, suppress_masks
from zeroshop_steps.detect.templates import render_templates
from zeroshop_steps.geometry.imaging.images import read_mask
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.partial_results import PartialResults

INTRINSICS = np.array([[420.0, 0, 80], [0, 420.0, 60], [0, 0, 1]])


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return (one & other).sum() / (one | other).sum()


def test_finds_carton_and_can_among_strange_blocks(dataset):
    assert detect(dataset, "contour") == 0
    found = read_detections(dataset.folder / "detections.json")
    for image in (0, 1):
        for index, number in enumerate((CARTON, CAN)):
            mine = [one for one in found if (one.image_id, one.object_id) == (image, number)]
            best = max(mine, key=lambda one: one.score)
            truth = read_mask(dataset.scene / "mask_visib" / f"{image:06d}_{index:06d}.png")
            assert overlap(decode_mask(best.mask), truth) > 0.85
            assert best.score > 2 * max([one.score for one in mine if one is not best], default=0), "blocks are less like it"
            assert best.seconds > 0


@pytest.mark.slow
def test_a_hollow_thing_is_found_whole_and_by_its_outer_face(shared_data):
    """A basket of TYO-L: its rim parts the outer face from the inside, and both the face and all of it are detections."""
    published = shared_data / "reports/tyol"
    if not published.is_dir():
        pytest.skip(f"{published} is not there")
    (model,) = read_models(published / "models", [19]).values()
    detector = prepare(argparse.Namespace(), {19: model}, lambda _: render_templates(model, 42, 224))
    frame = read_scene(published / "test_with_masks/000019")[10]
    frame = replace(frame, folder=published / "test/000019")
    truth = read_mask(published / "test_with_masks/000019/mask_visib/000010_000000.png")
    overlaps = [overlap(one.mask, truth) for one in detector(frame)]
    assert max(overlaps) > 0.7 and 0.35 < overlaps[0] < 0.5


@pytest.mark.slow
def test_the_same_twice(dataset):
    without_time = []
    for _ in range(2):
        assert detect(dataset, "contour", "--targets", str(dataset.folder / "test_targets_bop19.json")) == 0
        entries = json.loads((dataset.folder / "detections.json").read_text())
        without_time.append([{**entry, "time": 0} for entry in entries])
    assert without_time[0] == without_time[1]


def test_a_killed_detector_continues_with_the_next_image(dataset, tmp_path):
    looked: list[int] = []
    mask = np.zeros((60, 80), bool)
    mask[10:30, 20:50] = True

    def run(last, out):
        def detector(frame):
            if frame.image_id > last:
                raise KeyboardInterrupt
            looked.append(frame.image_id)
            return [ObjectMask(CAN, 1 / 3, mask), ObjectMask(CARTON, np.float32(0.7), mask.copy())]

        frames = read_frames(dataset.scenes, None)
        with PartialResults(tmp_path / out, {"models": dataset.folder}) as kept:
            run_detector(tmp_path / out, frames, detector, kept)
        return [{**entry, "time": 0} for entry in json.loads((tmp_path / out).read_text())]

    with pytest.raises(KeyboardInterrupt):
        run(0, "found.json")
    assert looked == [0]
    found = run(1, "found.json")
    assert looked == [0, 1] and found == run(1, "whole.json")


def plane_depth(noise_mm: float = 0.0) -> np.ndarray:
    """A table that falls away upwards, 120 x 160 px, with a block of 20 mm on it."""
    rows, columns = np.mgrid[:120, :160]
    depth = 1 / (1 / 700 + (rows - 60) * 4e-6 + (columns - 80) * 1e-6)
    depth[40:70, 50:90] -= 25
    return depth + np.random.default_rng(0).normal(0, noise_mm, depth.shape)


@pytest.mark.parametrize("noise_mm", [0.0, 1.0])
def test_the_table_is_ground_and_what_stands_on_it_is_not(noise_mm):
    ground = find_ground(plane_depth(noise_mm), INTRINSICS, 150.0)
    assert ground[:38].mean() > 0.99 and ground[72:].mean() > 0.99
    assert ground[42:68, 52:88].mean() < 0.01


def test_a_near_side_of_a_box_is_no_ground_however_much_of_the_image_it_fills():
    depth = plane_depth()
    depth[:, 100:] = 450.0  # 64 x 128 mm, more than a third of the image
    ground = find_ground(depth, INTRINSICS, 150.0)
    assert ground[72:, :90].mean() > 0.99 and not ground[:, 101:].any()


def test_a_table_with_a_floor_behind_it_is_ground_and_so_is_the_floor():
    depth = plane_depth()
    depth[:30] = 2500.0
    ground = find_ground(depth, INTRINSICS, 150.0)
    assert ground[:29].mean() > 0.99 and ground[72:].mean() > 0.99 and ground[42:68, 52:88].mean() < 0.01


def test_normals_look_at_the_camera():
    surface = prepare_surface(np.full((120, 160), 500.0), INTRINSICS, 150.0, "here")
    np.testing.assert_allclose(surface.normals[10:-10, 10:-10], np.broadcast_to([0.0, 0.0, -1.0], (100, 140, 3)), atol=1e-3)


def test_an_empty_depth_image_is_refused():
    with pytest.raises(StepError, match="scene 1, image 0 has 0 measured pixels"):
        prepare_surface(np.zeros((120, 160)), INTRINSICS, 150.0, "scene 1, image 0")


def stripe(columns: slice) -> np.ndarray:
    mask = np.zeros((4, 20), bool)
    mask[:, columns] = True
    return mask


def test_what_a_surer_detection_explains_counts_less():
    found = discount_explained(
        [ObjectMask(2, 0.5, stripe(np.s_[5:15])), ObjectMask(1, 0.8, stripe(np.s_[:10])), ObjectMask(3, 0.6, stripe(np.s_[15:]))]
    )
    scores = {one.object_id: one.score for one in found}
    assert scores == pytest.approx({1: 0.8, 2: 0.5 * (1 - 0.8 * 0.5), 3: 0.6})
    assert discount_explained([]) == []


def test_doubles_go_and_neighbours_stay():
    masks, scores = [stripe(np.s_[:10]), stripe(np.s_[1:11]), stripe(np.s_[8:20])], np.array([0.5, 0.9, 0.1])
    assert suppress_masks(masks, scores, 0.25) == [1, 2]
    boxes = np.array([(0, 0, 10, 4), (1, 0, 10, 4), (8, 0, 12, 4)], float)
    assert suppress_boxes(boxes, scores, 0.25) == [1, 2]
    assert suppress_masks([], np.zeros(0), 0.25) == suppress_boxes(np.zeros((0, 4)), np.zeros(0), 0.25) == []


def test_nothing_on_the_table_is_no_detection(dataset):
    for image in (0, 1):
        path = dataset.scene / "depth" / f"{image:06d}.png"
        rows, columns = np.mgrid[:240, :320]
        flat = 1 / (1 / 700 + (rows - 120) * 2e-6)
        assert cv2.imwrite(str(path), np.rint(flat).astype(np.uint16))
    assert detect(dataset, "contour") == 0
    assert read_detections(dataset.folder / "detections.json") == []


def spoil_missing_depth(dataset):
    (dataset.scene / "depth" / "000001.png").unlink()


def spoil_missing_color(dataset):
    (dataset.scene / "rgb" / "000001.png").unlink()


def spoil_depth_size(dataset):
    assert cv2.imwrite(str(dataset.scene / "depth" / "000001.png"), np.full((120, 160), 700, np.uint16))


def spoil_scale(dataset):
    spoil_camera(dataset, depth_scale=0)


def spoil_camera_size(dataset):
    spoil_camera(dataset, cam_K=[840.0, 0, 320, 0, 840.0, 240, 0, 0, 1])


def spoil_camera(dataset, **changed):
    path = dataset.scene / "scene_camera.json"
    cameras = json.loads(path.read_text())
    cameras["1"] |= changed
    path.write_text(json.dumps(cameras))


def spoil_templates(dataset):
    (dataset.folder / "templates" / f"obj_{CAN:06d}.npz").unlink()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_missing_depth, "has no image 000001 .scene 1, image 1., and this detector needs depth"),
        (spoil_missing_color, "detectors need colour images"),
        (spoil_depth_size, "is 160 x 120 px, its colour image is 320 x 240 px"),
        (spoil_scale, "depth_scale of image 1 is 0"),
        (spoil_camera_size, "camera and image are of different sizes"),
        (spoil_templates, "holds no views of object 8"),
    ],
)
def test_bad_input_is_named(dataset, capsys, spoil, message):
    spoil(dataset)
    assert detect(dataset, "contour") == 1
    assert re.search(message, capsys.readouterr().err)
    assert not (dataset.folder / "detections.json").exists()
