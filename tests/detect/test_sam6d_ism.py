"""SAM-6D's instance segmentation: its scores are the published ones, and with features made from the truth it finds what is there."""

import numpy as np
import pytest
import torch

from helpers.painted_scene import CAN, CARTON, detect
from helpers.paths import PARITY
from helpers.sam6d_cases import region_case
from helpers.true_features import TrueDescriber
from zeroshop_steps.bop.formats.detections import decode_mask, read_detections
from zeroshop_steps.bop.formats.models import read_models
from zeroshop_steps.detect.detector_io import read_photo
from zeroshop_steps.detect.sam6d_ism import (
    ObjectViews,
    compare_views,
    describe_object,
    find_objects,
    measure_visible_ratio,
    overlap_boxes,
    project_box,
    score_appearance,
)
from zeroshop_steps.detect.templates import read_templates

TOLERANCE = 1e-4


class Recalled:
    """A describer that answers what it is given."""

    def __init__(self, wholes, patches):
        self._answer = wholes, patches

    def describe_patches(self, regions):
        return self._answer


@pytest.fixture(scope="module")
def recorded():
    with np.load(PARITY / "sam6d_ism.npz") as file:
        return {name: file[name] for name in file.files}


def test_the_scores_of_a_region_agree_with_the_reference(recorded):
    case = region_case()
    objects = {
        number: ObjectViews(wholes, patches, case.rotations, 1000 * points)
        for number, (wholes, patches, points) in enumerate(zip(case.view_wholes, case.view_patches, case.points_m, strict=True))
    }
    photo = np.zeros((*case.depth_mm.shape, 3), np.uint8)
    for index, mask in enumerate(case.masks):
        describer = Recalled(case.wholes[index : index + 1], case.patches[index : index + 1])
        (found,) = find_objects([mask], photo, case.depth_mm, case.intrinsics, describer, objects)
        assert found.object_id == recorded["numbers"][index]
        assert found.score == pytest.approx(recorded["scores"][index], rel=TOLERANCE)
        known = objects[found.object_id]
        view = int(compare_views(case.wholes[index : index + 1], known.wholes)[0].argmax())
        assert view == recorded["views"][index]
        assert score_appearance(case.patches[index], known.patches[view]) == pytest.approx(recorded["appearance"][index], rel=TOLERANCE)
        assert measure_visible_ratio(case.patches[index], known.patches[view]) == pytest.approx(recorded["visible"][index], rel=TOLERANCE)
        assert overlap_boxes(tuple(recorded["boxes"][index]), tuple(case.boxes[index])) == pytest.approx(
            recorded["overlaps"][index], rel=TOLERANCE
        )
    assert len(set(recorded["numbers"])) > 1 and recorded["visible"].std() > 0.1, "the cases differ"


def test_a_region_whose_box_is_elsewhere_has_no_geometry():
    assert overlap_boxes((0, 0, 4, 4), (4, 0, 8, 4)) == 0.0
    assert overlap_boxes((0, 0, 4, 4), (2, 0, 6, 4)) == pytest.approx(1 / 3)
    box = project_box(np.array([[-50.0, 0, 0], [50, 20, 0]]), np.eye(3), np.array([0, 0, 100.0]), np.diag([100.0, 100, 1]), (30, 30))
    assert box == (0, 0, 29, 20), "the image ends the box"


@pytest.mark.slow
def test_objects_and_views_are_found_by_features_made_from_the_truth(dataset):
    """Also the can behind the carton's corner, with half as much noise as signal."""
    models, objects = read_models(dataset.folder / "models", [CARTON, CAN]), {}
    describer = TrueDescriber(models, noise=0.5)
    for number, model in models.items():
        views = read_templates(dataset.folder / "templates", number)
        describer.learn_views(number, views)
        objects[number] = describe_object(model, views, describer)
    for frame in dataset.frames:
        photo, masks = read_photo(frame), [frame.mask(index) for index in range(2)]
        describer.learn_frame(photo, frame)
        found = find_objects(masks, photo, frame.depth_mm(), frame.intrinsics, describer, objects)
        assert {(one.object_id, one.mask.sum()) for one in found} == {(CARTON, masks[0].sum()), (CAN, masks[1].sum())}
        assert all(0.4 < one.score < 1 for one in found)


@pytest.mark.slow
def test_the_command_writes_what_random_networks_find_and_needs_depth_in_millimetres(dataset, weights, capsys):
    options = ("--points-per-side", "4", "--least-iou", "0.5", "--least-stability", "0.3", "--width-px", "160", "--device", "cpu")
    assert detect(dataset, "sam6d_ism", *options) == 0
    found = read_detections(dataset.folder / "detections.json")
    assert {one.object_id for one in found} <= {CARTON, CAN} and {one.image_id for one in found} == {0, 1}
    assert all(0 < one.score <= 1 and decode_mask(one.mask).shape == (240, 320) for one in found)
    camera = dataset.scene / "scene_camera.json"
    whole = camera.read_text()
    camera.write_text(whole.replace('"depth_scale": 1.0', '"depth_scale": 0.001'))
    assert detect(dataset, "sam6d_ism", *options) == 1
    assert "looks like metres" in capsys.readouterr().err
    camera.write_text(whole)
    (dataset.scene / "depth" / "000000.png").unlink()
    assert detect(dataset, "sam6d_ism", *options) == 1
    assert "use --method cnos, which needs colour only" in capsys.readouterr().err


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is CUDA")
def test_cuda_that_is_not_there_is_refused(dataset, capsys):
    assert detect(dataset, "sam6d_ism", "--device", "cuda") == 1
    assert "PyTorch finds no CUDA device" in capsys.readouterr().err
