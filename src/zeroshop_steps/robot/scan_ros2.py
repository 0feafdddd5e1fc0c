"""Record a scan by ROS 2, and say where to look next: services ~/record and ~/next_view (std_srvs/Trigger), topic ~/viewpoint.

`next_view` publishes the pose of the camera's optical frame in the base frame; bring the camera there (MoveIt), then call `record`. Asked
again without a record between, it proposes another view. The folder is a capture with cameras at any time; one that was begun is continued.
Needs ROS 2 in a shell in which its setup.bash was sourced, with the Python version of this environment. It was run against a stand-in.
"""

import argparse
from typing import Any

from zeroshop_steps.robot.ros2.process import require_packages, serve
from zeroshop_steps.robot.scan_node import NODE, ScanNode, add_scan_arguments, make_node, write_pose_stamped

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


def start_scan(node: Any, scan: ScanNode) -> list[Any]:
    """Subscribe to the topics and offer the services of a node. Its executor must have several threads: images come meanwhile."""
    from geometry_msgs.msg import PoseStamped
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
    from sensor_msgs.msg import CameraInfo, Image
    from std_srvs.srv import Trigger
    from tf2_msgs.msg import TFMessage

    group = ReentrantCallbackGroup()
    publisher = node.create_publisher(PoseStamped, "~/viewpoint", 1)

    def record(request: Any, response: Any) -> Any:
        return answer(scan.record(), response)

    def next_view(request: Any, response: Any) -> Any:
        reply = scan.next_view()
        if reply.base_from_camera is not None:
            message = write_pose_stamped(PoseStamped, reply.base_from_camera, scan.base_frame)
            message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
        return answer(reply, response)

    def answer(reply: Any, response: Any) -> Any:
        if not reply.success:
            node.get_logger().warning(reply.message)
        response.success, response.message = reply.success, reply.message
        return response

    once = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    heard = [
        (Image, scan.topics["image"], scan.take_image, qos_profile_sensor_data),
        (CameraInfo, scan.topics["info"], scan.take_info, qos_profile_sensor_data),
        (TFMessage, "/tf", lambda message: scan.take_transforms(message, False), QoSProfile(depth=100)),
        (TFMessage, "/tf_static", lambda message: scan.take_transforms(message, True), once),
    ]
    if scan.topics.get("depth"):
        heard.append((Image, scan.topics["depth"], scan.take_depth, qos_profile_sensor_data))
    parts = [node.create_subscription(kind, topic, take, qos, callback_group=group) for kind, topic, take, qos in heard]
    parts += [node.create_service(Trigger, "~/record", record, callback_group=group)]
    return [*parts, node.create_service(Trigger, "~/next_view", next_view, callback_group=group), publisher]
