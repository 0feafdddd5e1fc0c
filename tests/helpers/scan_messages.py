"""Messages of a camera on an arm for the scan's node, as ROS 2 has them (rosbags has their definitions)."""

from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.robot.ros2.messages import blank
from zeroshop_steps.robot.scan_node import ScanNode, make_node
from zeroshop_steps.ros.image_messages import write_image

WIDTH, HEIGHT = 160, 120
OPTICAL, BASE = "camera_color_optical_frame", "base"
CENTRE = np.array([0.6, 0.0, 0.1])


def stamp(message, time_s: float):
    message.header.stamp.sec, message.header.stamp.nanosec = int(time_s), round(1e9 * (time_s - int(time_s)))
    return message


def image(values: np.ndarray, encoding: str, time_s: float, frame: str = OPTICAL):
    header = blank("std_msgs/msg/Header")
    header.frame_id = frame
    return stamp(write_image(lambda: blank("sensor_msgs/msg/Image"), values, encoding, header), time_s)


def photo(time_s: float, seed: int = 0):
    return image(np.random.default_rng(seed).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8), "rgb8", time_s)


def depth(time_s: float, frame: str = OPTICAL):
    return image(np.full((HEIGHT, WIDTH), 0.35, np.float32), "32FC1", time_s, frame)


def camera_info():
    message = blank("sensor_msgs/msg/CameraInfo")
    message.width, message.height, message.k = WIDTH, HEIGHT, np.array([150.0, 0, 79.5, 0, 150, 59.5, 0, 0, 1])
    return message


def transforms(parent: str, child: str, parent_from_child: np.ndarray, time_s: float):
    one = stamp(blank("geometry_msgs/msg/TransformStamped"), time_s)
    one.header.frame_id, one.child_frame_id = parent, child
    place, turn = one.transform.translation, one.transform.rotation
    place.x, place.y, place.z = parent_from_child[:3, 3].tolist()
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(parent_from_child[:3, :3]).as_quat().tolist()
    return SimpleNamespace(transforms=[one])


def view(azimuth_deg: float) -> np.ndarray:
    direction = direction_at(np.radians(azimuth_deg), np.radians(40.0))
    return np.linalg.inv(look_at(CENTRE + 0.35 * direction, CENTRE))


BASE_LINK_FROM_BASE = np.diag([-1.0, -1.0, 1.0, 1.0])  # as UR's driver has them
FLANGE_FROM_CAMERA = np.array([[0.0, -1, 0, 0.07], [1, 0, 0, 0], [0, 0, 1, 0.03], [0, 0, 0, 1]])


def stand(node: ScanNode, base_from_camera: np.ndarray, from_s: float, to_s: float) -> None:
    """The arm stands still at a view for a while: base_link -> flange -> camera."""
    for time_s in np.arange(from_s, to_s + 1e-9, 0.05):
        flange = BASE_LINK_FROM_BASE @ base_from_camera @ np.linalg.inv(FLANGE_FROM_CAMERA)
        node.take_transforms(transforms("base_link", "flange", flange, float(time_s)), False)


def arguments(folder: Path, **changes) -> Namespace:
    usual = {
        "image_topic": "/camera/color/image_raw",
        "camera_info_topic": "/camera/color/camera_info",
        "depth_topic": "/camera/aligned_depth_to_color/image_raw",
        "base_frame": BASE,
        "position_deviation": 0.001,
        "rotation_deviation": 0.1,
        "box": [*CENTRE.tolist(), 0.2, 0.2, 0.2],
        "without_depth": False,
        "least_views": 1,
        "baseline_m": None,
        "nearest_m": 0.25,
        "least_elevation_deg": 10.0,
        "arm": None,
        "flange_from_camera": None,
        "reach_m": 1.3,
        "out": folder / "scan",
    }
    return Namespace(**{**usual, **changes})


def make_placed_node(folder: Path) -> ScanNode:
    """A node that knows how its camera is mounted, and its lens."""
    node = make_node(arguments(folder))
    node.take_transforms(transforms("base_link", BASE, BASE_LINK_FROM_BASE, 0.0), True)
    node.take_transforms(transforms("flange", OPTICAL, FLANGE_FROM_CAMERA, 0.0), True)
    node.take_info(camera_info())
    return node


def show(node: ScanNode, time_s: float, seed: int = 0) -> None:
    node.take_image(photo(time_s, seed))
    node.take_depth(depth(time_s + 0.01))
