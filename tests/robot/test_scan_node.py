"""The scan's node, with messages of ROS 2 (rosbags has their definitions) and a stand-in of rclpy."""

import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zeroshop_steps.capture.adapters.tf_tree import TransformTree
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.robot import scan_node
from zeroshop_steps.robot.ros1 import scan_services
from zeroshop_steps.robot.ros1.environment import provide_ros
from zeroshop_steps.robot.ros2.messages import blank
from zeroshop_steps.robot.ros2.scan_services import start_scan, write_pose_stamped
from zeroshop_steps.robot.scan_node import ScanNode, make_node
from zeroshop_steps.ros.image_messages import write_image
from zeroshop_steps.runtime.errors import StepError

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


@pytest.fixture
def node(tmp_path: Path) -> ScanNode:
    node = make_node(arguments(tmp_path))
    node.take_transforms(transforms("base_link", BASE, BASE_LINK_FROM_BASE, 0.0), True)
    node.take_transforms(transforms("flange", OPTICAL, FLANGE_FROM_CAMERA, 0.0), True)
    node.take_info(camera_info())
    return node


def show(node: ScanNode, time_s: float, seed: int = 0) -> None:
    node.take_image(photo(time_s, seed))
    node.take_depth(depth(time_s + 0.01))


def test_views_are_recorded_with_the_pose_of_their_time(node: ScanNode, tmp_path: Path) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    reply = node.record()
    assert reply.success and "recorded 0001.png" in reply.message, reply.message
    given = read_given_cameras(tmp_path / "scan/cameras.json")
    np.testing.assert_allclose(given.poses["0001.png"], np.linalg.inv(view(180)), atol=1e-6)
    one = given.images["0001.png"]
    assert one.lens.params == (150.0, 150.0, 80.0, 60.0) and given.position_deviation_m == 0.001 and given.depth_step_mm == 0.1
    assert given.source == "tf of base"


def test_views_are_proposed_one_after_the_other(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    first = node.next_view()
    assert first.success and first.base_from_camera is not None and "no view yet" in first.message
    node.record()
    far, other = node.next_view(), node.next_view()
    assert far.base_from_camera is not None and other.base_from_camera is not None
    assert np.linalg.norm(far.base_from_camera[:3, 3] - other.base_from_camera[:3, 3]) > 0.03
    assert far.base_from_camera[0, 3] > 0.6  # the side that was not seen


def test_it_says_when_it_is_enough(node: ScanNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zeroshop_steps.scan.next_views.ENOUGH_SHARE", 1e9)
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    assert node.record().success
    reply = node.next_view()
    assert reply.success and reply.message.startswith("enough: 1 views") and reply.base_from_camera is None


def test_an_arm_that_moves_is_refused(node: ScanNode) -> None:
    for step in range(25):
        stand(node, view(150 + step), 9.0 + 0.05 * step, 9.0 + 0.05 * step)
    show(node, 10.1)
    reply = node.record()
    assert not reply.success and "not at rest" in reply.message


def lack_image(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)


def lack_info(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    node._info = None


def lack_depth(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    node.take_image(photo(10.0))
    node.take_depth(depth(9.5))


def other_depth(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    node.take_image(photo(10.0))
    node.take_depth(depth(10.0, "camera_depth_optical_frame"))


def other_clock(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 99.0)


def other_frame(node: ScanNode) -> None:
    node.take_image(image(np.zeros((HEIGHT, WIDTH, 3), np.uint8), "rgb8", 10.0, "elsewhere"))
    node.take_depth(depth(10.0, "elsewhere"))


def other_base(node: ScanNode) -> None:
    node.base_frame = "world"
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)


def other_size(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    node.take_image(image(np.zeros((60, 80, 3), np.uint8), "rgb8", 10.0))
    node.take_depth(depth(10.0))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lack_image, "no image has come on /camera/color/image_raw"),
        (lack_info, "no camera message has come on /camera/color/camera_info"),
        (lack_depth, "no depth on .* within 20 ms"),
        (other_depth, "of the frame 'camera_depth_optical_frame'.*aligned"),
        (other_clock, r"at the image's time, 99\.00 s.*from 9\.00 to 10\.20 s.*clocks"),
        (other_frame, "tf does not know the camera's frame 'elsewhere'"),
        (other_base, "tf does not know the base frame 'world'"),
        (other_size, "about images of 160 x 120 px"),
    ],
)
def test_what_is_missing_is_told(node: ScanNode, tmp_path: Path, spoil, message: str) -> None:
    spoil(node)
    reply = node.record()
    assert not reply.success
    with pytest.raises(StepError, match=message):
        raise StepError(reply.message)
    assert not (tmp_path / "scan").exists()


def test_an_old_image_is_not_recorded(node: ScanNode, monkeypatch: pytest.MonkeyPatch) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    monkeypatch.setattr(scan_node, "STALE_S", -1.0)
    assert "does the camera still run" in node.record().message


def test_options_that_contradict_are_told(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="either --depth-topic, or --without-depth"):
        make_node(arguments(tmp_path, depth_topic=None))


def test_tf_does_not_grow_without_end() -> None:
    tree = TransformTree()
    for time_s in range(100):
        tree.add(transforms("a", "b", np.eye(4), float(time_s)), False)
        tree.add(transforms("b", "c", np.eye(4), 0.0), True)
    tree.forget_before(90_000_000_000)
    assert len(tree.find_chain("c")[1].times_ns) == 10 and tree.look_up("c", 95_000_000_000) is not None
    tree.forget_before(10**15)
    assert tree.find_chain("b")[0].times_ns == [99_000_000_000]


def test_services_and_topics_of_ros2(node: ScanNode, monkeypatch: pytest.MonkeyPatch) -> None:
    heard, served, sent, warned = {}, {}, [], []
    contents = {
        "rclpy": {},
        "rclpy.callback_groups": {"ReentrantCallbackGroup": object},
        "rclpy.qos": {
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="kept"),
            "QoSProfile": lambda depth, durability=None: (depth, durability),
            "qos_profile_sensor_data": "sensor",
        },
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": lambda: blank("geometry_msgs/msg/PoseStamped")},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"CameraInfo": "CameraInfo", "Image": "Image"},
        "std_srvs": {},
        "std_srvs.srv": {"Trigger": "Trigger"},
        "tf2_msgs": {},
        "tf2_msgs.msg": {"TFMessage": "TFMessage"},
    }
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    clock = SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: blank("builtin_interfaces/msg/Time")))
    ros_node = SimpleNamespace(
        create_publisher=lambda kind, topic, depth: SimpleNamespace(publish=sent.append),
        create_subscription=lambda kind, topic, take, qos, callback_group: heard.update({topic: (kind, take, qos)}),
        create_service=lambda kind, name, serve, callback_group: served.update({name: serve}),
        get_logger=lambda: SimpleNamespace(warning=warned.append),
        get_clock=lambda: clock,
    )
    start_scan(ros_node, node)
    assert set(served) == {"~/record", "~/next_view"} and heard["/tf_static"][2] == (100, "kept")
    answer = served["~/record"](None, SimpleNamespace())
    assert not answer.success and warned == [answer.message]
    stand(node, view(180), 9.0, 10.2)
    heard["/camera/color/image_raw"][1](photo(10.0))
    heard["/camera/aligned_depth_to_color/image_raw"][1](depth(10.0))
    assert served["~/record"](None, SimpleNamespace()).success
    assert served["~/next_view"](None, SimpleNamespace()).success
    (message,) = sent
    assert message.header.frame_id == BASE and message.pose.position.x > 0.6


def test_a_pose_survives_its_message() -> None:
    message = write_pose_stamped(lambda: blank("geometry_msgs/msg/PoseStamped"), view(70), BASE)
    turn, place = message.pose.orientation, message.pose.position
    np.testing.assert_allclose(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), view(70)[:3, :3], atol=1e-9)
    np.testing.assert_allclose([place.x, place.y, place.z], view(70)[:3, 3])


def test_without_ros2_the_remedy_is_said(tmp_path: Path) -> None:
    words = ["--image-topic", "/a", "--camera-info-topic", "/b", "--without-depth", "--box", *["0.6", "0", "0.1", "0.2", "0.2", "0.2"]]
    command = [sys.executable, "-m", "zeroshop_steps.robot", "--method", "scan_ros2", *words, "--out", str(tmp_path / "scan")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 1 and "rclpy" in ended.stderr and "setup.bash" in ended.stderr


def test_services_and_topics_of_ros1(node: ScanNode, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same answers by rospy, whose times have other names."""
    heard, served, sent, warned = {}, {}, [], []
    contents = {
        "rospy": {
            "Publisher": lambda topic, kind, queue_size, latch: SimpleNamespace(publish=sent.append),
            "Subscriber": lambda topic, kind, take, queue_size: heard.update({topic: (kind, take)}),
            "Service": lambda name, kind, serve: served.update({name: serve}),
            "logwarn": warned.append,
            "Time": SimpleNamespace(now=lambda: blank("builtin_interfaces/msg/Time")),
        },
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": lambda: blank("geometry_msgs/msg/PoseStamped")},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"CameraInfo": "CameraInfo", "Image": "Image"},
        "std_srvs": {},
        "std_srvs.srv": {"Trigger": "Trigger", "TriggerResponse": SimpleNamespace},
    }
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(scan_services, "find_transforms", lambda: "TFMessage")
    scan_services.start_scan(node)
    assert set(served) == {"~record", "~next_view"} and {"/tf", "/tf_static"} < set(heard)
    answer = served["~record"](None)
    assert not answer.success and warned == [answer.message] and "no image has come" in answer.message

    def rename(message):
        time = message.header.stamp
        message.header.stamp = SimpleNamespace(secs=time.sec, nsecs=time.nanosec)
        return message

    for time_s in np.arange(9.0, 10.25, 0.05):
        flange = BASE_LINK_FROM_BASE @ view(180) @ np.linalg.inv(FLANGE_FROM_CAMERA)
        message = transforms("base_link", "flange", flange, float(time_s))
        rename(message.transforms[0])
        heard["/tf"][1](message)
    heard["/camera/color/image_raw"][1](rename(photo(10.0)))
    heard["/camera/aligned_depth_to_color/image_raw"][1](rename(depth(10.0)))
    assert served["~record"](None).success and served["~next_view"](None).success
    (message,) = sent
    assert message.header.frame_id == BASE and message.pose.position.x > 0.6


def test_transforms_are_known_without_their_package() -> None:
    """ROS compares digests of definitions before it connects."""
    try:
        provide_ros()
    except StepError:
        pytest.skip("ROS 1 is not installed")
    assert scan_services.find_transforms()._md5sum == "94810edda583a504dfda3829e70d7eec"
