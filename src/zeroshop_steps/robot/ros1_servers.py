"""Start the action servers of ROS 1: /object_detector/NAME and /pose_estimator/NAME for every method whose weights are here.

They speak robokudo_msgs/GenericImgProcAnnotator. The models are a folder in BOP's layout, or a dataset's folder of results, such as
results/demo, whose meshes are taken again when the workflow makes them anew. The camera matrix comes from the topic that the parameter
/cam_info_topic names, from --camera-info-topic, or from --intrinsics. Needs ROS 1 and a running roscore.
"""

import argparse
import threading
import time
from typing import Any

from zeroshop_steps.robot.goal_camera import CameraSource, FixedCamera, TopicCamera, add_camera_arguments
from zeroshop_steps.robot.goals import answer_goal
from zeroshop_steps.robot.prepared import add_recognizer_arguments, prepare_recognizers
from zeroshop_steps.robot.recognizers import Recognizer
from zeroshop_steps.robot.ros1.environment import provide_ros, require_master
from zeroshop_steps.robot.ros1.messages import ActionMessages, load_messages
from zeroshop_steps.runtime.errors import StepError

LEAST_S = 0.05
"""From a goal to its answer. actionlib's client for Python loses an answer that comes while it still notes the goal, and waits without
an end: of 1,000 goals that were answered at once, some were lost."""
NODE = "zeroshop_recognition"
PARAMETER = "/cam_info_topic"
"""By which the grasping pipeline names the topic of its camera (its documentation, "Adding a new estimator")."""


class RecognitionServers:
    """The servers of all recognizers. Goals are computed one after the other: each of them takes all cores anyway."""

    def __init__(self, recognizers: dict[str, Recognizer], camera: CameraSource, messages: ActionMessages) -> None:
        self.camera, self.messages = camera, messages
        self._turn = threading.Lock()
        self._servers = [self._start(name, recognizer) for name, recognizer in recognizers.items()]

    def _start(self, name: str, recognizer: Recognizer) -> Any:
        import actionlib

        def execute(goal: Any) -> None:
            self._execute(goal, recognizer, server)

        server = actionlib.SimpleActionServer(name, self.messages.action, execute_cb=execute, auto_start=False)
        server.start()
        return server

    def _execute(self, goal: Any, recognizer: Recognizer, server: Any) -> None:
        import rospy

        start_s = time.monotonic()
        with self._turn:
            answer = answer_goal(goal, recognizer, self.camera.intrinsics_of, self.messages.types)
        time.sleep(max(0.0, LEAST_S - (time.monotonic() - start_s)))
        if answer.succeeded:
            server.set_succeeded(answer.result, answer.reason)
        else:
            rospy.logwarn("%s refused a goal: %s", server.action_server.ns, answer.reason)
            server.set_aborted(answer.result, answer.reason)


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
