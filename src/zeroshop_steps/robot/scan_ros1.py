"""Record a scan by ROS 1, and say where to look next: services ~record and ~next_view (std_srvs/Trigger), topic ~viewpoint.

They do what those of `scan_ros2` do. Needs ROS 1 with std_srvs, and a running roscore.
"""

import argparse

from zeroshop_steps.robot.ros1.environment import provide_ros, require_master
from zeroshop_steps.robot.ros1.scan_services import start_scan
from zeroshop_steps.robot.scan_node import NODE, add_scan_arguments, make_node


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
