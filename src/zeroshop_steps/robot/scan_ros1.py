"""Record a scan by ROS 1, and say where to look next: services ~record and ~next_view (std_srvs/Trigger), topic ~viewpoint.

They do what those of `scan_ros2` do. Needs ROS 1 with std_srvs, and a running roscore.
"""

import argparse
import importlib.util
from typing import Any

from zeroshop_steps.robot.ros1.environment import provide_ros, require_master
from zeroshop_steps.robot.ros1.messages import SEPARATOR
from zeroshop_steps.robot.scan_node import NODE, Reply, ScanNode, add_scan_arguments, make_node, write_pose_stamped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_scan_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Serve until ROS shuts down."""
    scan = make_node(args)
    provide_ros("std_srvs")
    require_master()
    import rospy

    rospy.init_node(NODE, argv=[""])
    parts = start_scan(scan)
    print(f"{NODE} is ready: rosservice call /{NODE}/next_view", flush=True)
    rospy.spin()
    del parts


def start_scan(scan: ScanNode) -> list[Any]:
    """Subscribe to the topics and offer the services of this process's node, which rospy answers in threads of their own."""
    import rospy
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import CameraInfo, Image
    from std_srvs.srv import Trigger, TriggerResponse

    publisher = rospy.Publisher("~viewpoint", PoseStamped, queue_size=1, latch=True)

    def record(request: Any) -> Any:
        return answer(scan.record())

    def next_view(request: Any) -> Any:
        reply = scan.next_view()
        if reply.base_from_camera is not None:
            message = write_pose_stamped(PoseStamped, reply.base_from_camera, scan.base_frame)
            message.header.stamp = rospy.Time.now()
            publisher.publish(message)
        return answer(reply)

    def answer(reply: Reply) -> Any:
        if not reply.success:
            rospy.logwarn(reply.message)
        return TriggerResponse(success=reply.success, message=reply.message)

    transforms = find_transforms()
    heard = [
        (transforms, "/tf", lambda message: scan.take_transforms(message, False)),
        (transforms, "/tf_static", lambda message: scan.take_transforms(message, True)),
        (CameraInfo, scan.topics["info"], scan.take_info),
        (Image, scan.topics["image"], scan.take_image),
    ]
    if scan.topics.get("depth"):
        heard.append((Image, scan.topics["depth"], scan.take_depth))
    parts = [rospy.Subscriber(topic, kind, take, queue_size=100) for kind, topic, take in heard]
    return [*parts, rospy.Service("~record", Trigger, record), rospy.Service("~next_view", Trigger, next_view), publisher]


def find_transforms() -> Any:
    """The class of tf2_msgs/TFMessage; made here by ROS's own generator where that package is not installed."""
    if importlib.util.find_spec("tf2_msgs") is not None:
        from tf2_msgs.msg import TFMessage

        return TFMessage
    import genpy.dynamic
    from geometry_msgs.msg import TransformStamped

    text = f"geometry_msgs/TransformStamped[] transforms{SEPARATOR}MSG: geometry_msgs/TransformStamped\n{TransformStamped._full_text}"
    return genpy.dynamic.generate_dynamic("tf2_msgs/TFMessage", text)["tf2_msgs/TFMessage"]
