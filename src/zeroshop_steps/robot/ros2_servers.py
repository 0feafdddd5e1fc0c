"""Start the action servers of ROS 2: the same as of ROS 1, by rclpy.

Needs ROS 2 in a shell in which its setup.bash was sourced, with the Python version of this environment, and robokudo_msgs, which
colcon builds from the folder ros/robokudo_msgs. rclpy was not at hand when this was written: it was run against a stand-in of rclpy.
"""

import argparse
import threading
from typing import Any

from zeroshop_steps.robot.goal_camera import CameraSource, FixedCamera, TopicCamera, add_camera_arguments
from zeroshop_steps.robot.goals import MessageTypes, answer_goal
from zeroshop_steps.robot.prepared import add_recognizer_arguments, prepare_recognizers
from zeroshop_steps.robot.recognizers import Recognizer
from zeroshop_steps.robot.ros2.process import require_packages, serve
from zeroshop_steps.runtime.errors import StepError

NODE = "zeroshop_recognition"
NEEDED = ("rclpy", "sensor_msgs", "geometry_msgs", "robokudo_msgs")


class GoalExecutor:
    """Answers the goals of one server. All executors of a process share a lock, so that goals are computed one after the other."""

    def __init__(self, recognizer: Recognizer, camera: CameraSource, types: MessageTypes, turn: threading.Lock, logger: Any) -> None:
        self.recognizer, self.camera, self.types, self._turn, self._logger = recognizer, camera, types, turn, logger

    def __call__(self, goal_handle: Any) -> Any:
        """The result of a goal, whose handle is told whether it succeeded (rclpy's execute_callback)."""
        with self._turn:
            answer = answer_goal(goal_handle.request, self.recognizer, self.camera.intrinsics_of, self.types)
        if answer.succeeded:
            goal_handle.succeed()
        else:
            self._logger.warning(f"a goal was refused: {answer.reason}")
            goal_handle.abort()
        return answer.result


def start_servers(node: Any, recognizers: dict[str, Recognizer], camera: CameraSource) -> list[Any]:
    """The action servers of a node, whose executor must have several threads: the camera's messages come while goals are computed."""
    from geometry_msgs.msg import Pose
    from rclpy.action import ActionServer
    from rclpy.callback_groups import ReentrantCallbackGroup
    from robokudo_msgs.action import GenericImgProcAnnotator
    from sensor_msgs.msg import Image, RegionOfInterest

    types, turn, group = (
        MessageTypes(GenericImgProcAnnotator.Result, Image, RegionOfInterest, Pose),
        threading.Lock(),
        ReentrantCallbackGroup(),
    )
    return [
        ActionServer(
            node,
            GenericImgProcAnnotator,
            name,
            execute_callback=GoalExecutor(recognizer, camera, types, turn, node.get_logger()),
            callback_group=group,
        )
        for name, recognizer in recognizers.items()
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_recognizer_arguments(parser)
    add_camera_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Serve until ROS shuts down."""
    require_packages(NEEDED, "; build robokudo_msgs with: colcon build --base-paths ros/robokudo_msgs")
    _, recognizers = prepare_recognizers(args)
    serve(NODE, lambda node: start_servers(node, recognizers, find_camera(args, node)), f"{', '.join(recognizers)} are ready")


def find_camera(args: argparse.Namespace, node: Any) -> CameraSource:
    """Where the camera matrix comes from. Raises StepError where nothing says it."""
    if args.intrinsics:
        return FixedCamera(*args.intrinsics)
    if not args.camera_info_topic:
        raise StepError("where is the camera matrix? Goals have none: give --camera-info-topic or --intrinsics")
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import CameraInfo

    camera = TopicCamera(args.camera_info_topic)
    node.create_subscription(CameraInfo, args.camera_info_topic, camera.take, qos_profile_sensor_data)
    return camera
