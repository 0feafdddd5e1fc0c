"""The scan's node behind ROS 1 and ROS 2, with stand-ins of rospy and rclpy."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.scan_messages import BASE, BASE_LINK_FROM_BASE, FLANGE_FROM_CAMERA, depth, photo, stand, transforms, view
from zeroshop_steps.robot import scan_ros1
from zeroshop_steps.robot.ros1.environment import provide_ros
from zeroshop_steps.robot.ros2.messages import blank
from zeroshop_steps.robot.scan_node import ScanNode
from zeroshop_steps.robot.scan_ros2 import start_scan, write_pose_stamped
from zeroshop_steps.runtime.errors import StepError


def stand_in(monkeypatch: pytest.MonkeyPatch, contents: dict[str, dict]) -> None:
    """Put modules with these members in place of ROS's."""
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)


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
    stand_in(monkeypatch, contents)
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
    stand_in(monkeypatch, contents)
    monkeypatch.setattr(scan_ros1, "find_transforms", lambda: "TFMessage")
    scan_ros1.start_scan(node)
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
    assert scan_ros1.find_transforms()._md5sum == "94810edda583a504dfda3829e70d7eec"
