"""Start the action servers of ROS 1: /object_detector/NAME and /pose_estimator/NAME for every method whose weights are here.

They speak robokudo_msgs/GenericImgProcAnnotator. The models are a folder in BOP's layout, or a dataset's folder of results, such as
results/demo, whose meshes are taken again when the workflow makes them anew. The camera matrix comes from the topic that the parameter
/cam_info_topic names, from --camera-info-topic, or from --intrinsics. Needs ROS 1 and a running roscore.
"""

import argparse

from zeroshop_steps.robot.goal_camera import CameraSource, FixedCamera, TopicCamera, add_camera_arguments
from zeroshop_steps.robot.prepared import add_recognizer_arguments, prepare_recognizers
from zeroshop_steps.robot.ros1.environment import provide_ros, require_master
from zeroshop_steps.robot.ros1.messages import load_messages
from zeroshop_steps.robot.ros1.servers import RecognitionServers
from zeroshop_steps.runtime.errors import StepError

NODE = "zeroshop_recognition"
PARAMETER = "/cam_info_topic"
"""By which the grasping pipeline names the topic of its camera (its documentation, "Adding a new estimator")."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_recognizer_arguments(parser)
    add_camera_arguments(parser)
    parser.add_argument(
        "--ros-arguments", nargs="*", default=[], metavar="NAME:=VALUE", help="what roslaunch appends, such as __name:=NODE"
    )


def run(args: argparse.Namespace) -> None:
    """Serve until ROS shuts down."""
    provide_ros()
    require_master()
    import rospy

    messages = load_messages()
    _, recognizers = prepare_recognizers(args)
    rospy.init_node(NODE, argv=["", *args.ros_arguments])
    servers = RecognitionServers(recognizers, find_camera(args), messages)
    origin = "the workspace" if messages.installed else "ZeroShOP's copy"
    print(f"{', '.join(recognizers)} are ready; messages of {origin}", flush=True)
    rospy.spin()
    del servers


def find_camera(args: argparse.Namespace) -> CameraSource:
    """Where the camera matrix comes from. Raises StepError where nothing says it."""
    import rospy

    if args.intrinsics:
        return FixedCamera(*args.intrinsics)
    from sensor_msgs.msg import CameraInfo

    topic = args.camera_info_topic or rospy.get_param(PARAMETER, None)
    if not topic:
        raise StepError(
            f"where is the camera matrix? Goals have none. Set the parameter {PARAMETER}, or give --camera-info-topic or --intrinsics"
        )
    camera = TopicCamera(topic)
    rospy.Subscriber(topic, CameraInfo, camera.take, queue_size=1)
    return camera
