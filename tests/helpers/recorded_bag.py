"""The tests' own robot: it records a capture as bags of ROS 1 and ROS 2, with its camera on a moving link."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera

START_NS, STEP_NS = 1_700_000_000_000_000_000, 200_000_000
COLOR, DEPTH = "/camera/color", "/camera/aligned_depth_to_color"
OPTICAL = "camera_color_optical_frame"
HAND_FROM_CAMERA = np.array([[0.0, 0, 1, 0.03], [-1, 0, 0, -0.02], [0, -1, 0, 0.05], [0, 0, 0, 1]])
"""The camera looks along the hand's x axis, as REP 103 has it."""


class Bag:
    """A bag of ROS 1 (a file) or ROS 2 (a folder) to write messages to."""

    def __init__(self, path: Path, ros: int) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        if ros == 1:  # not among what rosbags knows of it
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
        self.ros = ros
        self._writer = Writer1(path) if ros == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> "Bag":
        self._writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.close()

    def make(self, name: str, **fields: Any) -> Any:
        """A message of this type; fields that are not given are 0 or empty."""
        kind = self.store.types[name]
        return kind(**{field: fields.pop(field, _zero(self, definition)) for field, definition in self.store.fielddefs[name][1]}, **fields)

    def header(self, time_ns: int, frame_id: str) -> Any:
        """A header of this time."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)

    def write(self, topic: str, message: Any, time_ns: int) -> None:
        """Record a message."""
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        content = self.store.serialize_ros1(message, kind) if self.ros == 1 else self.store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], time_ns, content)

    def write_image(self, topic: str, image: np.ndarray, encoding: str, time_ns: int, frame_id: str = OPTICAL) -> None:
        """Record an image."""
        data = np.frombuffer(np.ascontiguousarray(image).tobytes(), np.uint8)
        shape = {"height": image.shape[0], "width": image.shape[1], "step": image[0].nbytes}
        header = self.header(time_ns, frame_id)
        self.write(topic, self.make("sensor_msgs/msg/Image", header=header, encoding=encoding, data=data, **shape), time_ns)

    def write_transform(self, topic: str, parent: str, child: str, pose: np.ndarray, time_ns: int) -> None:
        """Record the (4, 4) transform parent_from_child, in metres."""
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", x=pose[0, 3], y=pose[1, 3], z=pose[2, 3]),
            rotation=self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        header = self.header(time_ns, parent)
        stamped = self.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform)
        self.write(topic, self.make("tf2_msgs/msg/TFMessage", transforms=[stamped]), time_ns)

    def write_camera(self, topic: str, camera: Camera, distortion: Sequence[float], model: str, time_ns: int) -> None:
        """Record the camera's message; ROS counts pixels from their centres."""
        matrix = camera.intrinsics.copy()
        matrix[:2, 2] -= 0.5
        fields = {"d": np.array(distortion, float), "k": matrix.ravel(), "r": np.eye(3).ravel(), "p": np.eye(3, 4).ravel()}
        if self.ros == 1:
            fields = {name.upper(): value for name, value in fields.items()}
        size = {"height": camera.height_px, "width": camera.width_px}
        header = self.header(time_ns, OPTICAL)
        self.write(topic, self.make("sensor_msgs/msg/CameraInfo", header=header, distortion_model=model, **size, **fields), time_ns)


def _zero(bag: Bag, definition: Any) -> Any:
    kind, detail = definition
    if kind == Nodetype.BASE:
        return "" if detail[0] == "string" else False if detail[0] == "bool" else np.dtype(detail[0]).type(0).item()
    if kind == Nodetype.NAME:
        return bag.make(detail)
    (_, inner_detail), length = detail
    return [] if inner_detail[0] not in np.sctypeDict else np.zeros(0 if kind == Nodetype.SEQUENCE else length, inner_detail[0])


def record(
    path: Path,
    ros: int,
    cameras: Sequence[Camera],
    pictures: Mapping[str, np.ndarray],
    depths_mm: Mapping[str, np.ndarray] | None = None,
    *,
    distortion: Sequence[float] = (),
    model: str = "plumb_bob",
    info: bool = True,
    tf_late_ns: int = 0,
    tf_nan: bool = False,
    depth_late_ns: int = 5_000_000,
    depth_frame: str = OPTICAL,
    infrared: bool = False,
) -> None:
    """Record an arm that stops at each of the cameras, whose poses are in metres; tf comes ten times as often as images.

    Args:
        pictures, depths_mm: by the camera's name.
        distortion, model: of the camera's message.
        info: whether the camera's message is recorded.
        tf_late_ns: of tf's clock.
        tf_nan: whether the hand's place is lost.
        depth_late_ns: of the depth camera.
        depth_frame: of the depth camera.
        infrared: whether grey pictures of twice the size are recorded, too.
    """
    with Bag(path, ros) as bag:
        bag.write_transform("/tf_static", "hand", OPTICAL, HAND_FROM_CAMERA, START_NS)
        for number, camera in enumerate(cameras):
            time_ns = START_NS + number * STEP_NS
            hand = np.linalg.inv(camera.camera_from_world) @ np.linalg.inv(HAND_FROM_CAMERA)
            hand[:3, 3] += np.nan if tf_nan else 0.0
            for part in (-1, 0, 1):  # at rest while a picture is taken
                bag.write_transform("/tf", "base", "hand", hand, time_ns + part * STEP_NS // 10 + tf_late_ns)
            bag.write_image(f"{COLOR}/image_raw", pictures[camera.name], "rgb8", time_ns)
            if info:
                bag.write_camera(f"{COLOR}/camera_info", camera, distortion, model, time_ns)
            if infrared:
                large = camera.resized(2 * camera.width_px, 2 * camera.height_px)
                bag.write_image("/camera/infra1/image_raw", np.zeros((large.height_px, large.width_px), np.uint8), "mono8", time_ns)
                bag.write_camera("/camera/infra1/camera_info", large, (), "", time_ns)
            if depths_mm is not None:
                steps = depths_mm[camera.name].astype("<u2")
                bag.write_image(f"{DEPTH}/image_raw", steps, "16UC1", time_ns + depth_late_ns, depth_frame)
