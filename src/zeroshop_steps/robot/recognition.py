"""What a robot asks and what it is answered, without any transport: one image with depth, and the objects in it.

A request that cannot be answered is refused by a `StepError`, whose message says what was found, what is needed and what to do.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import Frame
from zeroshop_steps.detect.detector_io import read_photo
from zeroshop_steps.geometry.imaging.depth_images import check_unit
from zeroshop_steps.runtime.errors import StepError


@dataclass(frozen=True)
class RecognitionRequest:
    """One image, and what to find in it.

    Attributes:
        photo: (height, width, 3) uint8 RGB.
        depth_mm: (height, width) float32 along the optical axis, aligned with the photo, 0 where nothing was measured; None if the
            camera has none.
        intrinsics: (3, 3) K; the centre of pixel (0, 0) is at (0, 0), as in BOP, OpenCV and ROS.
        class_names: of detectors: the objects to look for, all if empty. Of estimators: the object in each mask.
        masks: (height, width) bool each.
        boxes_px: (x, y, width, height) each, in place of masks or beside them.
        confidences: of the detections, by the object's name, where they are known.
    """

    photo: np.ndarray
    depth_mm: np.ndarray | None
    intrinsics: np.ndarray
    class_names: tuple[str, ...] = ()
    masks: tuple[np.ndarray, ...] = ()
    boxes_px: tuple[tuple[int, int, int, int], ...] = ()
    confidences: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RecognizedObject:
    """One object in the image.

    Attributes:
        name, object_id: its model.
        confidence: 0..1.
        box_px: (x, y, width, height).
        mask: (height, width) bool.
        camera_from_model: (4, 4) in mm; None of a detection.
        description: of the model: its scale, and where that is from.
    """

    name: str
    object_id: int
    confidence: float
    box_px: tuple[int, int, int, int]
    mask: np.ndarray
    camera_from_model: np.ndarray | None
    description: str


@dataclass(frozen=True)
class Recognition:
    """The answer to a request: the objects, the most confident first, and remarks on what was left out."""

    objects: tuple[RecognizedObject, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class LiveFrame(Frame):
    """A frame whose images are in memory, for detectors and estimators that take frames of a dataset."""

    photo: np.ndarray = field(kw_only=True)
    measured_mm: np.ndarray | None = field(kw_only=True)

    def color(self) -> np.ndarray:
        """(height, width, 3) uint8."""
        return self.photo

    @property
    def has_depth(self) -> bool:
        """Whether depth was measured."""
        return self.measured_mm is not None

    def depth_mm(self) -> np.ndarray:
        """(height, width) float32, 0 where nothing was measured. Raises StepError where there is none."""
        if self.measured_mm is None:
            raise StepError("the request has no depth image; send one that is aligned with the colour image")
        return self.measured_mm

    @property
    def name(self) -> str:
        """How messages call it."""
        return "the request"


def make_frame(request: RecognitionRequest) -> LiveFrame:
    """The frame of a request. Raises StepError where its parts do not fit together, or nothing was measured."""
    _check_request(request)
    frame = LiveFrame(0, 0, request.intrinsics, None, None, (), Path(), photo=request.photo, measured_mm=request.depth_mm)
    read_photo(frame)  # refuses a camera of another image size
    return frame


def _check_request(request: RecognitionRequest) -> None:
    if request.photo.ndim != 3 or request.photo.shape[2] != 3 or request.photo.dtype != np.uint8 or not request.photo.size:
        raise StepError(f"the colour image has the shape {request.photo.shape} of {request.photo.dtype}; expected (height, width, 3) uint8")
    focal_px = request.intrinsics[[0, 1], [0, 1]]
    if not np.isfinite(request.intrinsics).all() or (focal_px <= 0).any():
        raise StepError(f"the camera matrix is {request.intrinsics.tolist()}; expected finite numbers and positive focal lengths")
    if request.depth_mm is not None:
        _check_size("the depth image", request.depth_mm, request.photo)
        if not (request.depth_mm > 0).any():
            raise StepError("the depth image has no measured pixel (all are 0, negative or NaN); check the depth camera")
        check_unit(request.depth_mm, "the depth image", "send 32FC1 in metres or 16UC1 in millimetres")
    for index, mask in enumerate(request.masks):
        _check_size(f"mask {index}", mask, request.photo)
        if not mask.any():
            raise StepError(f"mask {index} is empty; send masks whose pixels on the object are not 0")
    height, width = request.photo.shape[:2]
    for index, (x, y, box_width, box_height) in enumerate(request.boxes_px):
        if min(x, y) < 0 or min(box_width, box_height) < 1 or x + box_width > width or y + box_height > height:
            raise StepError(
                f"box {index} is {box_width} x {box_height} px at ({x}, {y}), not within the image of {width} x {height} px;"
                " send x_offset, y_offset, width and height in pixels of the colour image"
            )


def _check_size(what: str, image: np.ndarray, photo: np.ndarray) -> None:
    if image.shape != photo.shape[:2]:
        sizes = " x ".join(map(str, image.shape[::-1])), f"{photo.shape[1]} x {photo.shape[0]}"
        raise StepError(f"{what} is {sizes[0]} px, the colour image is {sizes[1]} px; send images of one size, aligned with each other")
