"""Goals become requests and recognitions become results, by messages that have the fields of ROS but need no ROS."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zeroshop_steps.robot.goals import MessageTypes, answer_goal, read_confidences, read_pose
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest, RecognizedObject, make_frame
from zeroshop_steps.ros.image_messages import write_image
from zeroshop_steps.runtime.errors import StepError

HEIGHT, WIDTH = 6, 8
INTRINSICS = np.array([[10.0, 0, 4], [0, 10, 3], [0, 0, 1]])
LEFT = np.arange(WIDTH) < 4 * np.ones((HEIGHT, 1))
HEADER = SimpleNamespace(frame_id="head_rgbd_sensor_rgb_frame")


def pose_message() -> SimpleNamespace:
    return SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())


TYPES = MessageTypes(SimpleNamespace, SimpleNamespace, SimpleNamespace, pose_message)


def goal(**changes) -> SimpleNamespace:
    photo = write_image(SimpleNamespace, np.full((HEIGHT, WIDTH, 3), 90, np.uint8), "rgb8", HEADER)
    depth = write_image(SimpleNamespace, np.full((HEIGHT, WIDTH), 0.7, np.float32), "32FC1", HEADER)
    mask = write_image(SimpleNamespace, LEFT.astype(np.uint8), "8UC1", HEADER)
    made = SimpleNamespace(rgb=photo, depth=depth, bb_detections=[], mask_detections=[mask], class_names=["mug"], description="")
    for name, value in changes.items():
        setattr(made, name, value)
    return made


class StandIn:
    """Finds what it was told, after the checks that all recognizers make."""

    def __init__(self, *objects: RecognizedObject, error: Exception | None = None) -> None:
        self.objects, self.error, self.request = objects, error, None

    def prepare(self) -> None:
        pass

    def recognize(self, request: RecognitionRequest) -> Recognition:
        self.request = request
        make_frame(request)
        if self.error:
            raise self.error
        return Recognition(self.objects, ("mask 3: left out",))


def answer(made: SimpleNamespace, recognizer: StandIn):
    return answer_goal(made, recognizer, lambda width, height: INTRINSICS, TYPES)


def test_an_object_is_told_in_metres_and_labels():
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    pose[:3, 3] = [120.0, -45.0, 810.0]
    objects = [
        RecognizedObject("mug", 4, 0.75, (0, 0, 4, 6), LEFT, pose, "true"),
        RecognizedObject("can", 2, 0.5, (3, 0, 5, 6), np.arange(WIDTH) >= 3 * np.ones((HEIGHT, 1)), pose, "true"),
    ]
    told = answer(goal(), StandIn(*objects))
    assert told.succeeded and told.result.success and told.result.result_feedback == "mask 3: left out"
    assert (told.result.class_names, told.result.class_ids) == (["mug", "can"], [4, 2])
    assert told.result.class_confidences == [0.75, 0.5] and len(told.result.pose_results) == 2
    place = told.result.pose_results[0].position
    assert (place.x, place.y, place.z) == pytest.approx((0.12, -0.045, 0.81))
    np.testing.assert_allclose(read_pose(told.result.pose_results[0]), pose, atol=1e-9)
    box = told.result.bounding_boxes[0]
    assert (box.x_offset, box.y_offset, box.width, box.height) == (0, 0, 4, 6)
    labels = np.frombuffer(told.result.image.data, "<i2").reshape(HEIGHT, WIDTH)
    assert told.result.image.encoding == "16SC1" and told.result.image.header is HEADER
    assert labels[0].tolist() == [0, 0, 0, 0, 1, 1, 1, 1], "where masks overlap, the first object has the pixel"


def test_an_image_without_objects_is_all_background():
    told = answer(goal(), StandIn())
    assert told.result.success and set(np.frombuffer(told.result.image.data, "<i2").tolist()) == {-1}


def test_a_goal_is_read_as_it_was_sent():
    region = SimpleNamespace(x_offset=1, y_offset=2, width=3, height=4)
    recognizer = StandIn()
    answer(goal(bb_detections=[region], description=json.dumps({"mug": "0.625"})), recognizer)
    request = recognizer.request
    assert request.photo.shape == (HEIGHT, WIDTH, 3) and request.depth_mm[0, 0] == pytest.approx(700)
    assert request.class_names == ("mug",) and request.boxes_px == ((1, 2, 3, 4),) and request.confidences == {"mug": 0.625}
    assert np.array_equal(request.masks[0], LEFT) and np.array_equal(request.intrinsics, INTRINSICS)


@pytest.mark.parametrize("description", ["", "the red mug", "[1, 2]", '{"mug": null}', "{"])
def test_other_descriptions_say_nothing_of_confidences(description):
    assert read_confidences(description) == {}


EMPTY = SimpleNamespace(height=0, width=0, encoding="", is_bigendian=0, step=0, data=b"")
BAD_GOALS = {
    "no colours": ({"rgb": EMPTY}, "the colour image is empty"),
    "depth all NaN": (
        {"depth": write_image(SimpleNamespace, np.full((HEIGHT, WIDTH), np.nan, np.float32), "32FC1", HEADER)},
        "the depth image has no measured pixel",
    ),
    "depth of another size": (
        {"depth": write_image(SimpleNamespace, np.ones((3, 4), np.float32), "32FC1", HEADER)},
        "the depth image is 4 x 3 px, the colour image is 8 x 6 px",
    ),
    "depth in millimetres as metres": (
        {"depth": write_image(SimpleNamespace, np.full((HEIGHT, WIDTH), 700, np.float32), "32FC1", HEADER)},
        "the depth image in 32FC1 is 7e+05 mm in the median",
    ),
    "an empty mask": (
        {"mask_detections": [write_image(SimpleNamespace, np.zeros((HEIGHT, WIDTH), np.uint8), "mono8", HEADER)]},
        "mask 0 is empty",
    ),
    "a mask of another size": (
        {"mask_detections": [write_image(SimpleNamespace, np.ones((3, 4), np.uint8), "mono8", HEADER)]},
        "mask 0 is 4 x 3 px",
    ),
    "a box outside": ({"bb_detections": [SimpleNamespace(x_offset=6, y_offset=0, width=4, height=2)]}, "box 0 is 4 x 2 px at"),
}


@pytest.mark.parametrize("name", BAD_GOALS)
def test_a_bad_goal_has_a_result_with_the_reason(name):
    changes, reason = BAD_GOALS[name]
    told = answer(goal(**changes), StandIn())
    assert not told.succeeded and not told.result.success
    assert reason in told.result.result_feedback and told.reason == told.result.result_feedback


def test_a_camera_of_another_size_is_refused():
    wide = INTRINSICS * [[40, 1, 40], [1, 40, 40], [1, 1, 1]]
    told = answer_goal(goal(), StandIn(), lambda width, height: wide, TYPES)
    assert "camera and image are of different sizes" in told.reason


def test_an_unknown_camera_is_a_reason():
    def unknown(width: int, height: int) -> np.ndarray:
        raise StepError("no camera matrix has come")

    assert answer_goal(goal(), StandIn(), unknown, TYPES).reason == "no camera matrix has come"


def test_a_fault_of_the_server_is_told_and_logged(capsys):
    told = answer(goal(), StandIn(error=IndexError("list index out of range")))
    assert not told.succeeded and told.reason.startswith("the server failed: IndexError: list index out of range")
    assert "Traceback" in capsys.readouterr().err
    assert "memory ran out" in answer(goal(), StandIn(error=MemoryError())).reason


def test_the_action_is_that_of_robokudo():
    """Names, types and order are what the checksum of ROS is made of; these are in the grasping pipeline's documentation."""
    text = (Path(__file__).parents[2] / "src/zeroshop_steps/robot/GenericImgProcAnnotator.action").read_text()
    fields = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert fields == [
        "sensor_msgs/Image rgb",
        "sensor_msgs/Image depth",
        "sensor_msgs/RegionOfInterest[] bb_detections",
        "sensor_msgs/Image[] mask_detections",
        "string[] class_names",
        "string description",
        "---",
        "bool success",
        "string result_feedback",
        "sensor_msgs/RegionOfInterest[] bounding_boxes",
        "int32[] class_ids",
        "string[] class_names",
        "float32[] class_confidences",
        "sensor_msgs/Image image",
        "geometry_msgs/Pose[] pose_results",
        "string[] descriptions",
        "---",
        "string feedback",
    ]
