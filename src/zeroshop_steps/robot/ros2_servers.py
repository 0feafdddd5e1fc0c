"""Start the action servers of ROS 2: the same as of ROS 1, by rclpy.

Needs ROS 2 in a shell in which its setup.bash was sourced, with the Python version of this environment, and robokudo_msgs, which
colcon builds from the folder ros/robokudo_msgs. rclpy was not at hand when this was written: it was run against a stand-in of rclpy.
"""

import argparse
from typing import Any

from zeroshop_steps.robot.goal_camera import CameraSource, FixedCamera, TopicCamera, add_camera_arguments
from zeroshop_steps.robot.prepared import add_recognizer_arguments, prepare_recognizers
from zeroshop_steps.robot.ros2.node import start_servers
from zeroshop_steps.robot.ros2.process import require_packages, serve
from zeroshop_steps.runtime.errors import StepError

NODE = "zeroshop_recognition"
NEEDED = ("rclpy", "sensor_msgs", "geometry_msgs", "robokudo_msgs")


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
