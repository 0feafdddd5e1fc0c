"""Detectors and pose estimators that answer requests. Every method of the stages `detect` and `pose` is one; none is named here."""

import argparse
import functools
import importlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from zeroshop_steps.bop.formats.detections import Detection, decode_mask, encode_mask, mask_to_box
from zeroshop_steps.detect.filter_masks import LEAST_SCORE, filter_detections
from zeroshop_steps.methods import DETECTORS, ESTIMATORS, Method, lacks, refusal
from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest, RecognizedObject, make_frame
from zeroshop_steps.runtime.errors import StepError

FILES = {"detect": ("models", "templates", "scenes", "out"), "pose": ("models", "scenes", "targets", "out")}
"""Arguments of each stage that name files: requests come without."""


class Recognizer(Protocol):
    """Answers requests about the models of a store."""

    def prepare(self) -> None:
        """Take the models as they are now; networks are loaded the first time."""

    def recognize(self, request: RecognitionRequest) -> Recognition:
        """The objects in an image. Raises StepError where the request cannot be answered."""


def make_recognizers(
    detectors: Sequence[str] | None,
    estimators: Sequence[str] | None,
    store: ObjectStore,
    options: Mapping[str, Sequence[str]],
    instances: int = 1,
) -> dict[str, Recognizer]:
    """The detectors and estimators by the names of their servers, /object_detector/NAME and /pose_estimator/NAME.

    Args:
        detectors, estimators: names of methods; None: all whose weights are here.
        store: the models.
        options: words of a command line for the method of a name.
        instances: the most detections of one object in an image.

    Raises:
        StepError: a method is unknown or lacks its weights, or an option is not its own.
    """
    made: dict[str, Recognizer] = {}
    kinds: tuple[tuple[str, str, dict[str, Method], Sequence[str] | None, Callable[..., Recognizer]], ...] = (
        ("detector", "detect", DETECTORS, detectors, functools.partial(ObjectDetector, instances=instances)),
        ("estimator", "pose", ESTIMATORS, estimators, PreparedEstimator),
    )
    unused = set(options)
    for kind, stage, methods, names, make in kinds:
        for name in _choose(kind, methods, names):
            module = importlib.import_module(f"zeroshop_steps.{methods[name].step}")
            place = f"/object_detector/{name}" if stage == "detect" else f"/pose_estimator/{name}"
            args = parse_options(module, files_of(stage, methods[name]), options.get(name, ()))
            made[place] = make(module, args, store, methods[name])
            unused.discard(name)
    if unused:
        raise StepError(f"options are given for {', '.join(sorted(unused))}, which no server is started for: {', '.join(made)}")
    if not made:
        raise StepError("no detector and no estimator was asked for, or none has its weights here")
    return made


def _choose(kind: str, methods: dict[str, Method], names: Sequence[str] | None) -> list[str]:
    if names is None:
        return [name for name, method in methods.items() if not lacks(method)]
    for name in names:
        if name not in methods:
            raise StepError(f"there is no {kind} {name}; there are {', '.join(methods)}")
        reason = refusal(kind, name, methods)
        if reason:
            raise StepError(reason)
    return list(names)


def files_of(stage: str, method: Method) -> tuple[str, ...]:
    """The arguments of a method that name files."""
    return (*FILES[stage], "templates") if stage == "pose" and method.templates else FILES[stage]


def parse_options(module: Any, files: Sequence[str], words: Sequence[str]) -> argparse.Namespace:
    """The arguments of a method, where those in `files` mean nothing. Raises StepError where an option is not its own."""
    parser = argparse.ArgumentParser(prog=module.__name__, exit_on_error=False)
    module.add_arguments(parser)
    places = [word for name in files for word in (f"--{name}", ".")]
    try:
        args, rest = parser.parse_known_args([*places, *words])
    except argparse.ArgumentError as error:
        raise StepError(f"options of {module.__name__}: {error}") from None
    if rest:
        raise StepError(f"{module.__name__} has no options {' '.join(rest)}")
    return args


class ObjectDetector:
    """A method of the stage `detect`, prepared for the models of a store."""

    def __init__(self, module: Any, args: argparse.Namespace, store: ObjectStore, method: Method, instances: int = 1) -> None:
        self.module, self.args, self.store, self.instances = module, args, store, instances
        self._generation = -1

    def prepare(self) -> None:
        """Take the models as they are now."""
        self.store.refresh()
        if self._generation != self.store.generation:
            self._detect = self.module.prepare(self.args, self.store.models, self.store.views_of)
            self._generation = self.store.generation

    def recognize(self, request: RecognitionRequest) -> Recognition:
        """The objects in an image, with masks that do not overlap. Raises StepError where the request cannot be answered."""
        frame = make_frame(request)
        self.prepare()
        wanted = {self.store.find(name).model.object_id for name in request.class_names}
        found = [one for one in self._detect(frame) if not wanted or one.object_id in wanted]
        detections = [Detection(0, 0, one.object_id, one.score, None, encode_mask(one.mask)) for one in found]
        kept = filter_detections(detections, LEAST_SCORE, Path("the detections"))
        seen: Counter[int] = Counter()
        objects = []
        for one in kept:
            seen[one.object_id] += 1
            if seen[one.object_id] <= self.instances:
                objects.append(self._name(one, decode_mask(one.require_mask())))
        remarks = () if objects else (f"no object was found with a confidence of at least {LEAST_SCORE:g}",)
        return Recognition(tuple(objects), remarks)

    def _name(self, found: Detection, mask: np.ndarray) -> RecognizedObject:
        name = self.store.name_of(found.object_id)
        told = self.store.objects[name].description
        return RecognizedObject(name, found.object_id, found.score, mask_to_box(mask), mask, None, told)


class PreparedEstimator:
    """A method of the stage `pose`, prepared for the models of a store."""

    def __init__(self, module: Any, args: argparse.Namespace, store: ObjectStore, method: Method) -> None:
        self.module, self.args, self.store, self.method = module, args, store, method
        self._generation = -1

    def prepare(self) -> None:
        """Take the models as they are now."""
        self.store.refresh()
        if self._generation != self.store.generation:
            views = (self.store.views_of,) if self.method.templates else ()
            self._estimate = self.module.prepare(self.args, self.store.models, *views)
            self._generation = self.store.generation

    def recognize(self, request: RecognitionRequest) -> Recognition:
        """The poses of the objects in the masks, in their order. An object whose pose cannot be estimated is left out with a remark.

        Raises:
            StepError: the request cannot be answered, or no pose could be estimated.
        """
        frame = make_frame(request)
        if request.depth_mm is None:
            raise StepError("there is no depth image, and poses are estimated from depth; send one that is aligned with the colour image")
        self.prepare()
        stored = [self.store.find(name) for name in request.class_names]
        masks = _masks_of(request)
        objects, remarks = [], []
        for index, (one, mask) in enumerate(zip(stored, masks, strict=True)):
            score = float(request.confidences.get(one.name, 1.0))
            detection = Detection(0, 0, one.model.object_id, score, mask_to_box(mask), None)
            found = self._estimate(detection, mask, request.photo, request.depth_mm, frame)
            if found is None:
                remarks.append(f"mask {index}: no pose of {one.name} was found; too little of its depth was measured")
                continue
            pose, confidence = found
            objects.append(RecognizedObject(one.name, one.model.object_id, confidence, mask_to_box(mask), mask, pose, one.description))
        if not objects:
            raise StepError("; ".join(remarks))
        return Recognition(tuple(objects), tuple(remarks))


def _masks_of(request: RecognitionRequest) -> list[np.ndarray]:
    """One mask for each name: those of the request, otherwise its boxes. Raises StepError where they are not as many."""
    if not request.class_names:
        raise StepError("class_names is empty; name the object in each mask")
    masks = list(request.masks)
    if not masks and request.boxes_px:
        masks = [_fill(box, request.photo.shape[:2]) for box in request.boxes_px]
    if len(masks) != len(request.class_names):
        raise StepError(
            f"there are {len(request.class_names)} class names, {len(request.masks)} masks and {len(request.boxes_px)} boxes;"
            " send one mask for each name, or one box where there are no masks"
        )
    if request.boxes_px and len(request.boxes_px) != len(request.class_names):
        raise StepError(f"there are {len(request.class_names)} class names, but {len(request.boxes_px)} boxes; send one for each, or none")
    return masks


def _fill(box_px: tuple[int, int, int, int], shape: tuple[int, int]) -> np.ndarray:
    x, y, width, height = box_px
    mask = np.zeros(shape, bool)
    mask[y : y + height, x : x + width] = True
    return mask
