"""Record a scan by ROS 2, and say where to look next: services ~/record and ~/next_view (std_srvs/Trigger), topic ~/viewpoint.

`next_view` publishes the pose of the camera's optical frame in the base frame; bring the camera there (MoveIt), then call `record`. Asked
again without a record between, it proposes another view. The folder is a capture with cameras at any time; one that was begun is continued.
Needs ROS 2 in a shell in which its setup.bash was sourced, with the Python version of this environment. It was run against a stand-in.
"""

import argparse
from typing import Any

from zeroshop_steps.robot.ros2.process import require_packages, serve
from zeroshop_steps.robot.ros2.scan_services import start_scan
from zeroshop_steps.robot.scan_node import NODE, add_scan_arguments, make_node

NEEDED = ("rclpy", "sensor_msgs", "geometry_msgs", "std_srvs", "tf2_msgs")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_scan_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Serve until ROS shuts down."""
    scan = make_node(args)
    require_packages(NEEDED)

    def start(node: Any) -> list[Any]:
        start_scan(node, scan)
        return []  # what it made is the node's, and ends with it

    serve(NODE, start, f"{NODE} is ready: ros2 service call /{NODE}/next_view std_srvs/srv/Trigger")
