"""Requests from recorded bags of ROS 1 and ROS 2, and what was recognized into bags of ROS 2 (MCAP), which Foxglove opens."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from zeroshop_steps.robot.goal_camera import read_lens
from zeroshop_steps.robot.goals import write_pose, write_result
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest, RecognizedObject
from zeroshop_steps.robot.ros2.messages import RESULT, bag_types, blank, message_store
from zeroshop_steps.ros.bags import MOST_APART_NS, RECTIFIED, require_rosbags, stamp_of
from zeroshop_steps.ros.image_messages import read_color, read_depth, write_image
from zeroshop_steps.runtime.errors import StepError

TOPICS = {
    "/camera/rgb/image": "sensor_msgs/msg/Image",
    "/camera/depth/image": "sensor_msgs/msg/Image",
    "/camera/rgb/camera_info": "sensor_msgs/msg/CameraInfo",
    "/recognition/result": RESULT,
    "/recognition/overlay": "sensor_msgs/msg/Image",
    "/recognition/objects": "visualization_msgs/msg/MarkerArray",
    "/tf": "tf2_msgs/msg/TFMessage",
}
IMAGES = ("Image", "CompressedImage")
COLORS = np.array([[230, 60, 50], [50, 140, 230], [70, 190, 80], [240, 190, 40], [170, 90, 210], [40, 200, 200]], np.uint8)
LINE_LIST, TEXT = 5, 9  # kinds of visualization_msgs/Marker
LINE_M, TEXT_M = 0.002, 0.03
EDGES = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1]
"""Of a box, between its corners, whose numbers have a bit for each axis."""


@dataclass(frozen=True)
class RecordedRequest:
    """A request from a bag.

    Attributes:
        stamp_ns: when its colour image was taken.
        frame_id: the camera's frame.
        request: without names and masks.
    """

    stamp_ns: int
    frame_id: str
    request: RecognitionRequest


def read_requests(path: Path, rgb_topic: str, depth_topic: str, info_topic: str) -> Iterator[RecordedRequest]:
    """The pairs of colour and depth in a bag, in their order.

    Args:
        path: a .bag of ROS 1, or a .mcap file or a bag's folder of ROS 2.
        rgb_topic, depth_topic: of sensor_msgs/Image or CompressedImage; colour is undistorted, and depth with it, unless the topic's name
            says that it is rectified.
        info_topic: of sensor_msgs/CameraInfo, whose first message counts.

    Raises:
        StepError: the bag cannot be read, or a topic is missing or of another type.
    """
    require_rosbags()
    from rosbags.highlevel import AnyReader, AnyReaderError

    kinds = {rgb_topic: IMAGES, depth_topic: IMAGES, info_topic: ("CameraInfo",)}
    try:
        with AnyReader([Path(path)], default_typestore=message_store()) as reader:
            _check_topics(path, {one.topic: one.msgtype for one in reader.connections}, kinds)
            info = next((message for _, message in _read(reader, [info_topic])), None)
            pending: dict[str, list[Any]] = {rgb_topic: [], depth_topic: []}
            for topic, message in _read(reader, [rgb_topic, depth_topic]):
                pending[topic].append(message)
                for color, depth in _pop_pairs(pending[rgb_topic], pending[depth_topic]):
                    photo, depth_mm = read_color(color), read_depth(depth)
                    lens = read_lens(info, photo.shape[1], photo.shape[0], RECTIFIED in rgb_topic.rpartition("/")[2])
                    request = RecognitionRequest(
                        lens.undistort(photo), None if depth_mm is None else lens.undistort(depth_mm), lens.intrinsics
                    )
                    yield RecordedRequest(stamp_of(color), color.header.frame_id, request)
    except (AnyReaderError, OSError, ValueError) as error:
        raise StepError(f"the bag {path} cannot be read: {error}") from None


def _read(reader: Any, topics: Sequence[str]) -> Iterator[tuple[str, Any]]:
    for connection, _, raw in reader.messages([one for one in reader.connections if one.topic in topics]):
        yield connection.topic, reader.deserialize(raw, connection.msgtype)


def _check_topics(path: Path, found: dict[str, str], kinds: dict[str, tuple[str, ...]]) -> None:
    for topic, names in kinds.items():
        if found.get(topic, "").rpartition("/")[2] not in names or not found[topic].startswith("sensor_msgs/"):
            listed = ", ".join(f"{name} ({found[name]})" for name in sorted(found)) or "none"
            raise StepError(f"the bag {path} has no topic {topic} of sensor_msgs/{' or '.join(names)}; it has {listed}")


def _pop_pairs(colors: list[Any], depths: list[Any]) -> Iterator[tuple[Any, Any]]:
    """Pairs of one time; what has no partner is dropped."""
    while colors and depths:
        apart_ns = stamp_of(colors[0]) - stamp_of(depths[0])
        if abs(apart_ns) <= MOST_APART_NS:
            yield colors.pop(0), depths.pop(0)
        else:
            (depths if apart_ns > 0 else colors).pop(0)


class RecognitionBag:
    """Writes images and what was recognized in them to a new folder: metadata.yaml and an MCAP file."""

    def __init__(self, folder: Path, bounds_of: Callable[[str], np.ndarray]) -> None:
        """Args:
        folder: must not exist.
        bounds_of: gives the (2, 3) lowest and highest corners of a model in mm by its name.
        """
        require_rosbags()
        from rosbags.rosbag2 import StoragePlugin, Writer

        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._bounds_of = bounds_of

    def __enter__(self) -> "RecognitionBag":
        self._writer.open()
        self._connections = {topic: self._writer.add_connection(topic, kind, typestore=message_store()) for topic, kind in TOPICS.items()}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._writer.close()

    def add(self, recorded: RecordedRequest, recognition: Recognition) -> None:
        """Write one image with its depth and camera, and the objects in it."""
        header = _make_header(recorded)
        request, image = recorded.request, bag_types().image
        photo = write_image(image, request.photo, "rgb8", header)
        messages = {
            "/camera/rgb/image": photo,
            "/camera/rgb/camera_info": _make_camera_info(request, header),
            "/recognition/result": write_result(recognition, "; ".join(recognition.remarks), photo, bag_types()),
            "/recognition/overlay": write_image(image, draw_overlay(request.photo, recognition.objects), "rgb8", header),
            "/recognition/objects": self._make_markers(recognition.objects, header),
            "/tf": _make_transforms(recognition.objects, header),
        }
        if request.depth_mm is not None:
            messages["/camera/depth/image"] = write_image(image, request.depth_mm / np.float32(1000), "32FC1", header)
        for topic, message in messages.items():
            raw = message_store().serialize_cdr(_with_arrays(message), TOPICS[topic])
            self._writer.write(self._connections[topic], recorded.stamp_ns, raw)

    def _make_markers(self, objects: Sequence[RecognizedObject], header: Any) -> Any:
        """A box and a name for each object with a pose."""
        array = blank("visualization_msgs/msg/MarkerArray")
        clear = blank("visualization_msgs/msg/Marker")
        clear.header, clear.action = header, 3  # DELETEALL: what an earlier image had
        array.markers.append(clear)
        for index, one in enumerate(objects):
            if one.camera_from_model is not None:
                corners = self._bounds_of(one.name)
                box, name = (_make_marker(kind, index, one.camera_from_model, header) for kind in (LINE_LIST, TEXT))
                box.scale.x, name.scale.z, name.text = LINE_M, TEXT_M, f"{one.name} {one.confidence:.2f}"
                ends = [[corners[(end >> axis) & 1, axis] for axis in range(3)] for edge in EDGES for end in edge]
                box.points = [_make_point(np.array(end) / 1000) for end in ends]
                array.markers += [box, name]
        return array


def draw_overlay(photo: np.ndarray, objects: Sequence[RecognizedObject]) -> np.ndarray:
    """(height, width, 3) uint8: the photo with the masks of the objects in colours."""
    drawn = photo.astype(np.float32)
    for index, one in enumerate(objects):
        drawn[one.mask] += 0.5 * (COLORS[index % len(COLORS)] - drawn[one.mask])
    return np.rint(drawn).astype(np.uint8)


def _make_header(recorded: RecordedRequest) -> Any:
    header = blank("std_msgs/msg/Header")
    header.stamp.sec, header.stamp.nanosec = divmod(recorded.stamp_ns, 10**9)
    header.frame_id = recorded.frame_id
    return header


def _make_camera_info(request: RecognitionRequest, header: Any) -> Any:
    info = blank("sensor_msgs/msg/CameraInfo")
    info.header, info.distortion_model, info.d = header, "plumb_bob", np.zeros(5)
    info.height, info.width = request.photo.shape[:2]
    info.k, info.r = request.intrinsics.ravel().astype(float), np.eye(3).ravel()
    info.p = np.hstack([request.intrinsics, np.zeros((3, 1))]).ravel().astype(float)
    return info


def _make_transforms(objects: Sequence[RecognizedObject], header: Any) -> Any:
    """The frames of the objects in the camera's; further ones of a name are numbered."""
    message, seen = blank("tf2_msgs/msg/TFMessage"), list[str]()
    for one in objects:
        if one.camera_from_model is None:
            continue
        pose, transform = write_pose(one.camera_from_model, bag_types()), blank("geometry_msgs/msg/TransformStamped")
        seen.append(one.name)
        transform.header, transform.child_frame_id = header, one.name + (f"_{seen.count(one.name)}" if seen.count(one.name) > 1 else "")
        place, turn = transform.transform.translation, pose.orientation
        place.x, place.y, place.z, transform.transform.rotation = pose.position.x, pose.position.y, pose.position.z, turn
        message.transforms.append(transform)
    return message


def _make_marker(kind: int, index: int, camera_from_model: np.ndarray, header: Any) -> Any:
    marker = blank("visualization_msgs/msg/Marker")
    marker.header, marker.type, marker.id, marker.pose = header, kind, index, write_pose(camera_from_model, bag_types())
    marker.ns = "boxes" if kind == LINE_LIST else "names"
    marker.color.r, marker.color.g, marker.color.b = (COLORS[index % len(COLORS)] / 255).tolist()
    marker.color.a = 1.0
    return marker


def _make_point(place_m: np.ndarray) -> Any:
    point = blank("geometry_msgs/msg/Point")
    point.x, point.y, point.z = place_m.tolist()
    return point


def _with_arrays(message: Any) -> Any:
    """The message with the arrays that rosbags wants where ROS takes bytes and lists."""
    if message.__msgtype__ == "sensor_msgs/msg/Image":
        message.data = np.frombuffer(message.data, np.uint8)
    elif message.__msgtype__ == RESULT:
        message.class_ids = np.array(message.class_ids, np.int32)
        message.class_confidences = np.array(message.class_confidences, np.float32)
        message.image.data = np.frombuffer(message.image.data, np.uint8)
    return message
