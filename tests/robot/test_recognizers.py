"""Every method of the stages detect and pose answers requests; bad ones are refused."""

import importlib
import inspect
from dataclasses import replace

import numpy as np
import pytest

from helpers.painted_scene import CAN, CARTON
from zeroshop_steps.bop.formats.models import read_models
from zeroshop_steps.bop.scoring.pose_error import ModelPoints, mssd
from zeroshop_steps.detect.detector_io import ObjectMask
from zeroshop_steps.geometry.imaging.images import read_image, read_mask
from zeroshop_steps.methods import DETECTORS, ESTIMATORS, Method, lacks
from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.robot.recognition import RecognitionRequest
from zeroshop_steps.robot.recognizers import ObjectDetector, PreparedEstimator, files_of, make_recognizers, parse_options
from zeroshop_steps.runtime.errors import StepError

METHOD = Method("stand_in")
NAMES = {CARTON: f"obj_{CARTON:06d}", CAN: f"obj_{CAN:06d}"}


@pytest.fixture(scope="module")
def store(dataset) -> ObjectStore:
    return ObjectStore(dataset.folder / "models")


@pytest.fixture(scope="module")
def request_of_all(dataset) -> RecognitionRequest:
    frame = dataset.frames[0]
    masks = tuple(read_mask(dataset.scene / "mask_visib" / f"000000_{index:06d}.png") for index in range(2))
    photo = read_image(dataset.scene / "rgb/000000.png")
    return RecognitionRequest(photo, frame.depth_mm(), frame.intrinsics, (NAMES[CARTON], NAMES[CAN]), masks)


class Detects:
    """A method that finds what it was told."""

    def __init__(self, *found: ObjectMask) -> None:
        self.found, self.prepared = found, 0

    def prepare(self, args, models, views_of):
        self.prepared += 1
        return lambda frame: self.found


class Estimates:
    """A method that gives each detection the same pose, and none where its mask is small."""

    def __init__(self) -> None:
        self.scores: list[float] = []

    def prepare(self, args, models):
        def estimate(detection, mask, photo, depth_mm, frame):
            self.scores.append(detection.score)
            return (np.eye(4), 0.9) if mask.sum() > 4 else None

        return estimate


def test_every_method_that_can_run_here_has_a_server(store):
    places = [f"/object_detector/{name}" for name, method in DETECTORS.items() if not lacks(method)]
    places += [f"/pose_estimator/{name}" for name, method in ESTIMATORS.items() if not lacks(method)]
    assert list(make_recognizers(None, None, store, {})) == places
    assert {"/object_detector/contour", "/pose_estimator/render_compare"} <= set(places)


@pytest.mark.parametrize("stage", ["detect", "pose"])
def test_every_method_can_be_prepared_without_files(stage):
    """Also those whose weights are not here: their options have defaults, and they take what the servers give."""
    for method in {"detect": DETECTORS, "pose": ESTIMATORS}[stage].values():
        module = importlib.import_module(f"zeroshop_steps.{method.step}")
        views = stage == "detect" or method.templates
        assert len(inspect.signature(module.prepare).parameters) == (3 if views else 2), method.name
        assert parse_options(module, files_of(stage, method), ()).models, method.name


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((["yolo"], [], {}), "there is no detector yolo; there are contour"),
        ((["cnos"], [], {}), "detector cnos cannot run here, it lacks"),
        (([], [], {}), "no detector and no estimator"),
        ((["contour"], [], {"contour": ["--device", "cuda"]}), "has no options --device cuda"),
        ((["contour"], [], {"render_compare": []}), "options are given for render_compare, which no server is started for"),
    ],
)
def test_methods_that_cannot_serve_are_named(store, arguments, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # without weights
    detectors, estimators, options = arguments
    with pytest.raises(StepError, match=reason):
        make_recognizers(detectors, estimators, store, options)


def test_masks_of_detections_do_not_overlap_and_the_best_of_each_object_stays(store, request_of_all):
    left, right = (np.zeros(request_of_all.photo.shape[:2], bool) for _ in range(2))
    left[:, :200], right[:, 150:] = True, True
    found = [ObjectMask(CAN, 0.5, right), ObjectMask(CARTON, 0.9, left), ObjectMask(CARTON, 0.4, ~left), ObjectMask(CAN, 0.1, ~right)]
    detector = ObjectDetector(Detects(*found), None, store, METHOD)
    told = detector.recognize(replace(request_of_all, class_names=(), masks=()))
    assert [(one.name, one.confidence, one.box_px) for one in told.objects] == [
        (NAMES[CARTON], 0.9, (0, 0, 200, 240)),
        (NAMES[CAN], 0.5, (200, 0, 120, 240)),
    ]
    assert not (told.objects[0].mask & told.objects[1].mask).any()
    told = detector.recognize(replace(request_of_all, class_names=(NAMES[CAN],), masks=()))
    assert [one.name for one in told.objects] == [NAMES[CAN]], "only what was asked for"
    assert ObjectDetector(Detects(), None, store, METHOD).recognize(request_of_all).remarks == (
        "no object was found with a confidence of at least 0.2",
    )


def test_models_are_prepared_once_until_they_change(store, request_of_all, monkeypatch):
    method = Detects()
    detector = ObjectDetector(method, None, store, METHOD)
    for _ in range(3):
        detector.recognize(request_of_all)
    assert method.prepared == 1
    monkeypatch.setattr(store, "generation", store.generation + 1)
    detector.recognize(request_of_all)
    assert method.prepared == 2


def test_an_estimator_that_compares_views_gets_them(store, request_of_all, monkeypatch):
    class Compares(Estimates):
        def prepare(self, args, models, views_of):
            self.views = [views_of(number) for number in models]
            return super().prepare(args, models)

    monkeypatch.setattr(store, "views_of", lambda number: f"views of {number}")
    method = Compares()
    PreparedEstimator(method, None, store, replace(METHOD, templates=True)).recognize(request_of_all)
    assert method.views == [f"views of {CARTON}", f"views of {CAN}"]


def test_a_pose_that_cannot_be_estimated_is_left_out_with_a_remark(store, request_of_all):
    small = np.zeros_like(request_of_all.masks[0])
    small[0, :3] = True
    method = Estimates()
    asked = replace(request_of_all, masks=(small, request_of_all.masks[1]), confidences={NAMES[CAN]: 0.25})
    told = PreparedEstimator(method, None, store, METHOD).recognize(asked)
    assert [one.name for one in told.objects] == [NAMES[CAN]] and method.scores == [1.0, 0.25]
    assert told.remarks == (f"mask 0: no pose of {NAMES[CARTON]} was found; too little of its depth was measured",)
    with pytest.raises(StepError, match="mask 1: no pose of"):
        PreparedEstimator(method, None, store, METHOD).recognize(replace(asked, masks=(small, small)))


def test_boxes_stand_for_missing_masks(store, request_of_all):
    told = PreparedEstimator(Estimates(), None, store, METHOD).recognize(
        replace(request_of_all, masks=(), boxes_px=((0, 0, 9, 9), (30, 20, 8, 7)))
    )
    assert [one.box_px for one in told.objects] == [(0, 0, 9, 9), (30, 20, 8, 7)] and told.objects[1].mask.sum() == 56


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"depth_mm": None}, "there is no depth image, and poses are estimated from depth"),
        ({"class_names": ()}, "class_names is empty"),
        ({"class_names": (NAMES[CAN], "teapot")}, "there is no object 'teapot' here. Known objects: obj_000003, obj_000008"),
        ({"class_names": (NAMES[CAN],)}, "there are 1 class names, 2 masks and 0 boxes"),
        ({"masks": ()}, "there are 2 class names, 0 masks and 0 boxes"),
        ({"boxes_px": ((0, 0, 5, 5),)}, "there are 2 class names, but 1 boxes"),
        ({"intrinsics": np.full((3, 3), np.nan)}, "the camera matrix is .*expected finite numbers"),
    ],
)
def test_requests_that_cannot_be_answered_are_refused(store, request_of_all, changes, reason):
    with pytest.raises(StepError, match=reason):
        PreparedEstimator(Estimates(), None, store, METHOD).recognize(replace(request_of_all, **changes))


@pytest.mark.slow
def test_real_methods_find_the_carton_and_its_pose(dataset, store, request_of_all):
    recognizers = make_recognizers(["contour"], ["render_compare"], store, {})
    found = recognizers["/object_detector/contour"].recognize(replace(request_of_all, class_names=(), masks=()))
    best = {one.name: one for one in found.objects}[NAMES[CARTON]]
    truth = request_of_all.masks[0]
    assert (best.mask & truth).sum() / (best.mask | truth).sum() > 0.8
    asked = replace(request_of_all, class_names=(best.name,), masks=(best.mask,))
    pose = recognizers["/pose_estimator/render_compare"].recognize(asked).objects[0].camera_from_model
    model = read_models(dataset.folder / "models", [CARTON])[CARTON]
    true = dataset.frames[0].instances[0].camera_from_model
    points = ModelPoints.from_vertices(model.mesh.vertices)
    assert mssd(pose[None], true[None], points, model.symmetries)[0] < 0.1 * model.diameter_mm
