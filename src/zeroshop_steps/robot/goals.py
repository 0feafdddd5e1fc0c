"""Goals and results of the action robokudo_msgs/GenericImgProcAnnotator, of ROS 1 and ROS 2 alike: both have the same fields."""

import json
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import make_transform
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest
from zeroshop_steps.robot.recognizers import Recognizer
from zeroshop_steps.ros.image_messages import LABELS, read_color, read_depth, read_mask, write_image
from zeroshop_steps.runtime.errors import StepError, explain_machine_fault

BACKGROUND = -1  # of label images


@dataclass(frozen=True)
class MessageTypes:
    """The classes of messages that results are made of."""

    result: Callable[[], Any]
    image: Callable[[], Any]
    region: Callable[[], Any]
    pose: Callable[[], Any]


@dataclass(frozen=True)
class Answer:
    """The result of a goal, and whether it succeeded; `reason` tells why not, or what was left out."""

    result: Any
    succeeded: bool
    reason: str


def answer_goal(goal: Any, recognizer: Recognizer, intrinsics_of: Callable[[int, int], np.ndarray], types: MessageTypes) -> Answer:
    """Answer a goal. A goal that cannot be answered gets a result with its reason; nothing is raised.

    Args:
        goal: the message.
        recognizer: prepared.
        intrinsics_of: gives (3, 3) K for images of a width and height; raises StepError where it is not known.
        types: of the result.
    """
    try:
        recognition = recognizer.recognize(read_goal(goal, intrinsics_of))
        reason = "; ".join(recognition.remarks)
        return Answer(write_result(recognition, reason, goal.rgb, types), True, reason)
    except StepError as error:
        reason = str(error)
    except Exception as error:
        traceback.print_exc()
        reason = explain_machine_fault(error) or f"the server failed: {type(error).__name__}: {error}; its log has the place"
    result = types.result()
    result.success, result.result_feedback = False, reason
    return Answer(result, False, reason)


def read_goal(goal: Any, intrinsics_of: Callable[[int, int], np.ndarray]) -> RecognitionRequest:
    """The request of a goal. Raises StepError where a part of it cannot be read."""
    photo = read_color(goal.rgb)
    depth_mm = read_depth(goal.depth)
    masks = tuple(read_mask(message, index) for index, message in enumerate(goal.mask_detections))
    boxes = tuple((int(one.x_offset), int(one.y_offset), int(one.width), int(one.height)) for one in goal.bb_detections)
    intrinsics = intrinsics_of(photo.shape[1], photo.shape[0])
    return RecognitionRequest(photo, depth_mm, intrinsics, tuple(goal.class_names), masks, boxes, read_confidences(goal.description))


def read_confidences(description: str) -> dict[str, float]:
    """Of the detections by name, which pipelines put into the description as JSON; empty where it holds anything else."""
    try:
        return {str(name): float(value) for name, value in json.loads(description).items()}
    except (ValueError, TypeError, AttributeError):
        return {}


def write_result(recognition: Recognition, feedback: str, photo: Any, types: MessageTypes) -> Any:
    """The result's message: boxes, names, confidences, a label image, and poses in metres.

    Args:
        recognition: what was found.
        feedback: remarks.
        photo: the goal's colour image, whose header and size the label image has.
        types: of the messages.
    """
    result = types.result()
    result.success, result.result_feedback = True, feedback
    labels = np.full((photo.height, photo.width), BACKGROUND, np.int16)
    for index, one in reversed(list(enumerate(recognition.objects))):
        labels[one.mask] = index
    result.image = write_image(types.image, labels, LABELS, photo.header)
    result.class_names = [one.name for one in recognition.objects]
    result.class_ids = [one.object_id for one in recognition.objects]
    result.class_confidences = [float(one.confidence) for one in recognition.objects]
    result.descriptions = [one.description for one in recognition.objects]
    result.bounding_boxes = [write_region(one.box_px, types) for one in recognition.objects]
    result.pose_results = [write_pose(one.camera_from_model, types) for one in recognition.objects if one.camera_from_model is not None]
    return result


def write_region(box_px: tuple[int, int, int, int], types: MessageTypes) -> Any:
    """A sensor_msgs/RegionOfInterest of (x, y, width, height)."""
    region = types.region()
    region.x_offset, region.y_offset, region.width, region.height = box_px
    return region


def write_pose(camera_from_model: np.ndarray, types: MessageTypes) -> Any:
    """A geometry_msgs/Pose, in metres, of a (4, 4) pose in mm."""
    pose = types.pose()
    pose.position.x, pose.position.y, pose.position.z = (camera_from_model[:3, 3] / 1000).tolist()
    x, y, z, w = Rotation.from_matrix(camera_from_model[:3, :3]).as_quat().tolist()
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = x, y, z, w
    return pose


def read_pose(message: Any) -> np.ndarray:
    """(4, 4) in mm of a geometry_msgs/Pose."""
    turn, place = message.orientation, message.position
    return make_transform(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), np.array([place.x, place.y, place.z]) * 1000)
