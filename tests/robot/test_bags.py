"""Bags are written so that MCAP's own reader for ROS 2, which Foxglove's is a twin of, understands every message, and read again."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.reader import read_ros2_messages

from helpers.painted_scene import CARTON
from zeroshop_steps.robot.bags import TOPICS, RecognitionBag, RecordedRequest, read_requests
from zeroshop_steps.robot.goals import read_pose
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest, RecognizedObject
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError

RGB, DEPTH, INFO = "/camera/rgb/image", "/camera/depth/image", "/camera/rgb/camera_info"
INTRINSICS = np.array([[50.0, 0, 20], [0, 51, 15], [0, 0, 1]])
POSE = np.array([[0.0, -1, 0, 50], [1, 0, 0, -20], [0, 0, 1, 700], [0, 0, 0, 1]])
START_NS = 1_700_000_000_123_456_789


def recorded(index: int, depth: bool = True) -> RecordedRequest:
    rng = np.random.default_rng(index)
    depth_mm = rng.integers(500, 900, (30, 40)).astype(np.float32) if depth else None
    photo = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    return RecordedRequest(START_NS + index * 33_000_000, "camera", RecognitionRequest(photo, depth_mm, INTRINSICS))


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """Three images, one without depth; in each a mug."""
    folder = tmp_path_factory.mktemp("bags") / "bag"
    mask = np.zeros((30, 40), bool)
    mask[5:9, 10:20] = True
    mug = RecognizedObject("mug", 4, 0.75, (10, 5, 10, 4), mask, POSE, "true")
    with RecognitionBag(folder, lambda name: np.array([[-40.0, -30, -50], [40, 30, 50]])) as writer:
        for index in range(3):
            writer.add(recorded(index, depth=index != 1), Recognition((mug,), ("a remark",)))
    return folder


def test_mcaps_reader_understands_every_message(bag):
    (path,) = bag.glob("*.mcap")
    messages = {}
    for one in read_ros2_messages(str(path)):
        messages.setdefault(one.channel.topic, []).append((one.log_time_ns, one.ros_msg))
    assert set(messages) == set(TOPICS) and {topic: len(found) for topic, found in messages.items()} == {
        topic: 2 if topic == DEPTH else 3 for topic in TOPICS
    }
    stamp_ns, photo = messages[RGB][2]
    assert stamp_ns == START_NS + 66_000_000 and photo.header.stamp.nanosec == stamp_ns % 10**9 and photo.header.frame_id == "camera"
    assert bytes(photo.data) == recorded(2).request.photo.tobytes() and (photo.width, photo.height, photo.encoding) == (40, 30, "rgb8")
    assert list(messages[INFO][0][1].k) == INTRINSICS.ravel().tolist()
    result = messages["/recognition/result"][0][1]
    assert result.success and result.result_feedback == "a remark" and list(result.class_ids) == [4]
    np.testing.assert_allclose(read_pose(result.pose_results[0]), POSE, atol=1e-9)
    (transform,) = messages["/tf"][0][1].transforms
    assert transform.child_frame_id == "mug" and transform.transform.translation.z == pytest.approx(0.7)
    clear, box, name = messages["/recognition/objects"][0][1].markers
    assert clear.action == 3 and name.text == "mug 0.75" and len(box.points) == 24
    ends = np.array([[point.x, point.y, point.z] for point in box.points]).reshape(12, 2, 3)
    lengths = np.sort(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
    np.testing.assert_allclose(lengths, np.repeat([0.06, 0.08, 0.1], 4), atol=1e-9)
    overlay = np.frombuffer(messages["/recognition/overlay"][0][1].data, np.uint8).reshape(30, 40, 3)
    changed = (overlay != recorded(0).request.photo).any(2)
    assert changed[6, 12] and not changed[0].any()


def test_pairs_of_colour_and_depth_are_read_again(bag):
    found = list(read_requests(bag, RGB, DEPTH, INFO))
    assert [one.stamp_ns for one in found] == [recorded(index).stamp_ns for index in (0, 2)], "one image has no depth of its time"
    for one, index in zip(found, (0, 2), strict=True):
        true = recorded(index).request
        assert np.array_equal(one.request.photo, true.photo) and one.frame_id == "camera"
        np.testing.assert_allclose(one.request.depth_mm, true.depth_mm, rtol=1e-6)
        assert np.array_equal(one.request.intrinsics, INTRINSICS)


def test_the_file_alone_is_a_bag(bag):
    assert len(list(read_requests(next(bag.glob("*.mcap")), RGB, DEPTH, INFO))) == 2


def test_bags_of_ros1_are_read_too(tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    header = kinds["std_msgs/msg/Header"](0, kinds["builtin_interfaces/msg/Time"](7, 9), "head")
    pixels, depth = recorded(0).request.photo, recorded(0).request.depth_mm.astype(np.uint16)
    roi = kinds["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    projection = np.hstack([INTRINSICS, np.zeros((3, 1))]).ravel()
    messages = {
        INFO: kinds["sensor_msgs/msg/CameraInfo"](
            header, 30, 40, "plumb_bob", np.zeros(5), INTRINSICS.ravel(), np.eye(3).ravel(), projection, 0, 0, roi
        ),
        RGB: kinds["sensor_msgs/msg/Image"](header, 30, 40, "bgr8", 0, 120, pixels[..., ::-1].ravel()),
        DEPTH: kinds["sensor_msgs/msg/Image"](header, 30, 40, "16UC1", 0, 80, depth.ravel().view(np.uint8)),
    }
    with Writer(tmp_path / "robot.bag") as writer:
        for topic, message in messages.items():
            connection = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(connection, 7_000_000_009, store.serialize_ros1(message, message.__msgtype__))
    (found,) = read_requests(tmp_path / "robot.bag", RGB, DEPTH, INFO)
    assert found.stamp_ns == 7_000_000_009 and found.frame_id == "head"
    assert np.array_equal(found.request.photo, pixels) and np.array_equal(found.request.depth_mm, depth)


def test_a_missing_topic_lists_those_that_are_there(bag):
    with pytest.raises(
        StepError,
        match=r"has no topic /rgb of sensor_msgs/Image or CompressedImage; it has .*/camera/depth/image \(sensor_msgs/msg/Image\)",
    ):
        next(read_requests(bag, "/rgb", DEPTH, INFO))
    with pytest.raises(StepError, match="has no topic /tf of sensor_msgs/CameraInfo"):
        next(read_requests(bag, RGB, DEPTH, "/tf"))


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\nrest", b"#ROSBAG V2.0\n"])
@pytest.mark.parametrize("name", ["damaged.mcap", "damaged.bag"])
def test_a_damaged_bag_is_named(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(StepError, match=f"the bag .*{name} cannot be read"):
        next(read_requests(tmp_path / name, RGB, DEPTH, INFO))


@pytest.mark.slow
def test_objects_of_a_recorded_bag_are_found_without_ros(dataset, tmp_path):
    frame = dataset.frames[0]
    request = RecordedRequest(START_NS, "camera", RecognitionRequest(frame.color(), frame.depth_mm(), frame.intrinsics))
    with RecognitionBag(tmp_path / "in", lambda name: np.zeros((2, 3))) as writer:
        writer.add(request, Recognition(()))
    words = ["--method", "recognize_bag", "--models", dataset.folder / "models", "--bag", tmp_path / "in", "--rgb-topic", RGB]
    words += ["--depth-topic", DEPTH, "--camera-info-topic", INFO, "--detectors", "contour", "--estimators", "render_compare"]
    words += ["--out", tmp_path / "out"]
    assert stage_main("zeroshop_steps.robot", list(map(str, words))) == 0
    messages = {one.channel.topic: one.ros_msg for one in read_ros2_messages(str(next((tmp_path / "out").glob("*.mcap"))))}
    result = messages["/recognition/result"]
    pose = read_pose(result.pose_results[result.class_names.index(f"obj_{CARTON:06d}")])
    assert np.linalg.norm(pose[:3, 3] - frame.instances[0].camera_from_model[:3, 3]) < 10


def test_without_rosbags_the_remedy_is_said(bag):
    words = "import sys; sys.modules['rosbags'] = None; from zeroshop_steps.ros.bags import require_rosbags as r; r()"
    ended = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True)
    assert "pip install 'zeroshop[robot]'" in ended.stderr
