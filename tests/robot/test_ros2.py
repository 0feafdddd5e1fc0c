"""The adapter to ROS 2, with messages of ROS 2 (rosbags has their definitions) and without rclpy."""

import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.robot.goal_camera import FixedCamera, TopicCamera
from zeroshop_steps.robot.goals import read_pose
from zeroshop_steps.robot.recognition import Recognition, RecognizedObject, make_frame
from zeroshop_steps.robot.ros2.messages import bag_types, blank
from zeroshop_steps.robot.ros2_servers import GoalExecutor, start_servers
from zeroshop_steps.ros.image_messages import write_image

HEIGHT, WIDTH = 6, 8
POSE = np.array([[0.0, -1, 0, 50], [1, 0, 0, -20], [0, 0, 1, 700], [0, 0, 0, 1]])


class StandIn:
    def prepare(self):
        pass

    def recognize(self, request):
        make_frame(request)
        mask = request.masks[0]
        return Recognition((RecognizedObject(request.class_names[0], 3, 0.5, (0, 0, 4, 6), mask, POSE, "true"),))


class Handle:
    """What rclpy's goal handle has."""

    def __init__(self, request) -> None:
        self.request, self.ended = request, []

    def succeed(self) -> None:
        self.ended.append("succeeded")

    def abort(self) -> None:
        self.ended.append("aborted")


def goal(depth_m: float):
    header = blank("std_msgs/msg/Header")
    make = lambda: blank("sensor_msgs/msg/Image")  # noqa: E731
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, :4] = 1
    return SimpleNamespace(
        rgb=write_image(make, np.full((HEIGHT, WIDTH, 3), 90, np.uint8), "rgb8", header),
        depth=write_image(make, np.full((HEIGHT, WIDTH), depth_m, np.float32), "32FC1", header),
        bb_detections=[],
        mask_detections=[write_image(make, mask, "8UC1", header)],
        class_names=["mug"],
        description="",
    )


@pytest.fixture
def executor():
    told = []
    logger = SimpleNamespace(warning=told.append)
    return GoalExecutor(StandIn(), FixedCamera(10, 10, 4, 3), bag_types(), threading.Lock(), logger), told


def test_a_goal_succeeds_with_a_result_of_ros2(executor):
    handle = Handle(goal(0.7))
    result = executor[0](handle)
    assert handle.ended == ["succeeded"] and result.success and result.class_names == ["mug"]
    np.testing.assert_allclose(read_pose(result.pose_results[0]), POSE, atol=1e-9)


def test_a_bad_goal_is_aborted_with_the_reason(executor):
    handle = Handle(goal(np.nan))
    result = executor[0](handle)
    assert handle.ended == ["aborted"] and not result.success
    assert "no measured pixel" in result.result_feedback and "no measured pixel" in executor[1][0]


def test_there_is_a_server_for_each_recognizer(monkeypatch):
    made = []

    class ActionServer:
        def __init__(self, node, action, name, execute_callback, callback_group) -> None:
            made.append((name, action, execute_callback))

    types = bag_types()
    action = SimpleNamespace(Result=types.result)
    contents = {
        "rclpy": {},
        "rclpy.action": {"ActionServer": ActionServer},
        "rclpy.callback_groups": {"ReentrantCallbackGroup": object},
        "robokudo_msgs": {},
        "robokudo_msgs.action": {"GenericImgProcAnnotator": action},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"Image": types.image, "RegionOfInterest": types.region},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"Pose": types.pose},
    }
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    node = SimpleNamespace(get_logger=lambda: None)
    servers = start_servers(node, {"/object_detector/a": StandIn(), "/pose_estimator/b": StandIn()}, FixedCamera(10, 10, 4, 3))
    assert len(servers) == 2 and [name for name, _, _ in made] == ["/object_detector/a", "/pose_estimator/b"]
    assert made[0][1] is action and made[1][2](Handle(goal(0.7))).success


def test_a_camera_of_ros2_is_taken():
    camera, message = TopicCamera("/camera_info"), blank("sensor_msgs/msg/CameraInfo")
    message.width, message.height, message.k = WIDTH, HEIGHT, np.array([10.0, 0, 4, 0, 10, 3, 0, 0, 1])
    camera.take(message)
    assert camera.intrinsics_of(WIDTH, HEIGHT)[0].tolist() == [10, 0, 4]


def test_without_ros2_the_remedy_is_said(tmp_path):
    command = [sys.executable, "-m", "zeroshop_steps.robot", "--method", "ros2_servers", "--models", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 1 and "rclpy" in ended.stderr and "colcon build --base-paths ros/robokudo_msgs" in ended.stderr


def test_ros2s_own_tool_reads_the_action(tmp_path):
    """Debian's python3-rosidl belongs to the system's Python."""
    words = "from pathlib import Path; from rosidl_adapter.action import convert_action_to_idl as convert; import sys;"
    words += "convert(Path(sys.argv[1]), 'robokudo_msgs', Path('action/GenericImgProcAnnotator.action'), Path(sys.argv[2]))"
    system = Path("/usr/bin/python3")
    if not system.exists() or subprocess.run([system, "-c", "import rosidl_adapter"], capture_output=True).returncode:
        pytest.skip("ROS 2's rosidl_adapter is not installed (Debian: python3-rosidl)")
    subprocess.run([system, "-c", words, REPOSITORY / "ros/robokudo_msgs", tmp_path], check=True, capture_output=True)
    idl = (tmp_path / "GenericImgProcAnnotator.idl").read_text()
    assert "sequence<sensor_msgs::msg::Image> mask_detections;" in idl and "sequence<geometry_msgs::msg::Pose> pose_results;" in idl
