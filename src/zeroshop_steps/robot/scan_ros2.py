"""Record a scan by ROS 2, and say where to look next: services ~/record and ~/next_view (std_srvs/Trigger), topic ~/viewpoint.

`next_view` publishes the pose of the camera's optical frame in the base frame; bring the camera there (MoveIt), then call `record`. Asked
again without a record between, it proposes another view. The folder is a capture with cameras at any time; one that was begun is continued.
Needs ROS 2 in a shell in which its setup.bash was sourced, with the Python version of this environment. It was run against a stand-in.
"""

import argparse
from pathlib import Path
from typing import Any

from zeroshop_steps.capture.cameras_json import Lens
from zeroshop_steps.robot.ros2.process import require_packages, serve
from zeroshop_steps.robot.ros2.scan_services import start_scan
from zeroshop_steps.robot.scan_node import ScanNode
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.recorder import ScanRecorder
from zeroshop_steps.scan.session import Scan
from zeroshop_steps.scan.setup import add_setup_arguments, make_reach, make_scan, make_surface

NODE = "zeroshop_scan"
NEEDED = ("rclpy", "sensor_msgs", "geometry_msgs", "std_srvs", "tf2_msgs")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--image-topic", required=True, help="sensor_msgs/Image of colour")
    parser.add_argument("--camera-info-topic", required=True, help="of the same camera")
    parser.add_argument("--depth-topic", help="sensor_msgs/Image of depth, aligned to colour")
    parser.add_argument("--base-frame", default="base", help="tf's frame that --box is in; of UR arms, `base` (default: %(default)s)")
    parser.add_argument("--position-deviation", type=float, help="how exact the poses are, metres (default: not known)")
    parser.add_argument("--rotation-deviation", type=float, help="the same, degrees")
    add_setup_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="capture folder to write")


def run(args: argparse.Namespace) -> None:
    """Serve until ROS shuts down."""
    scan = make_node(args)
    require_packages(NEEDED)

    def start(node: Any) -> list[Any]:
        start_scan(node, scan)
        return []  # what it made is the node's, and ends with it

    serve(NODE, start, f"{NODE} is ready: ros2 service call /{NODE}/next_view std_srvs/srv/Trigger")


def make_node(args: argparse.Namespace) -> ScanNode:
    """The node without ROS. Raises StepError for options that contradict, and for a folder that is another capture."""
    if bool(args.depth_topic) == args.without_depth:
        raise StepError("give either --depth-topic, or --without-depth: then views are planned by the box alone")
    make_surface(args)  # so that options out of range are told of now
    recorder = ScanRecorder(args.out, f"tf of {args.base_frame}", args.position_deviation, args.rotation_deviation)

    def scan_with(lens: Lens) -> Scan:
        return make_scan(args, recorder, lens)

    topics = {"image": args.image_topic, "info": args.camera_info_topic, "depth": args.depth_topic or ""}
    return ScanNode(scan_with, make_reach(args), args.base_frame, topics)
