"""Start the action servers of ROS 1: /object_detector/NAME and /pose_estimator/NAME for every method whose weights are here.

They speak robokudo_msgs/GenericImgProcAnnotator. The models are a folder in BOP's layout, or a dataset's folder of results, such as
results/demo, whose meshes are taken again when the workflow makes them anew. The camera matrix comes from the topic that the parameter
/cam_info_topic names, from --camera-info-topic, or from --intrinsics. Needs ROS 1 and a running roscore.
"""

import argparse
import shlex
import sys
from pathlib import Path

from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.robot.recognizers import make_recognizers
from zeroshop_steps.robot.ros1.camera import PARAMETER, GivenCamera, TopicCamera
from zeroshop_steps.robot.ros1.environment import provide_ros, require_master
from zeroshop_steps.robot.ros1.messages import load_messages
from zeroshop_steps.robot.ros1.servers import CameraSource, RecognitionServers
from zeroshop_steps.runtime.errors import StepError

NODE = "zeroshop_recognition"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    add_recognizer_arguments(parser)
    parser.add_argument("--camera-info-topic", help=f"topic of the camera's matrix (default: what the parameter {PARAMETER} names)")
    parser.add_argument("--intrinsics", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"), help="of the camera, in place of a topic")
    parser.add_argument(
        "--ros-arguments", nargs="*", default=[], metavar="NAME:=VALUE", help="what roslaunch appends, such as __name:=NODE"
    )


def add_recognizer_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that say what is recognized, and how."""
    parser.add_argument("--models", type=Path, required=True, help="folder of models in BOP's layout, or of a dataset's results")
    parser.add_argument("--nvs", default="2dgs", help="surface method whose meshes are taken from results (default: %(default)s)")
    parser.add_argument("--objects", nargs="*", default=[], help="names of the models to take (default: all)")
    parser.add_argument("--detectors", nargs="*", help="methods of the stage detect (default: all whose weights are here)")
    parser.add_argument("--estimators", nargs="*", help="methods of the stage pose (default: all whose weights are here)")
    parser.add_argument("--instances", type=int, default=1, help="the most detections of an object in an image (default: %(default)s)")
    parser.add_argument("--templates", type=Path, help="folder that keeps rendered views of the models between starts")
    parser.add_argument(
        "--options", nargs=2, action="append", default=[], metavar=("METHOD", "WORDS"), help="of a method, such as cnos '--device cuda'"
    )


def run(args: argparse.Namespace) -> None:
    """Serve until ROS shuts down."""
    provide_ros()
    require_master()
    import rospy

    messages = load_messages()
    store = ObjectStore(args.models, args.nvs, args.objects, args.templates)
    for reason in store.refused.values():
        print(f"left out: {reason}", file=sys.stderr)
    options = {name: shlex.split(words) for name, words in args.options}
    recognizers = make_recognizers(args.detectors, args.estimators, store, options, args.instances)
    for recognizer in recognizers.values():
        recognizer.prepare()
    rospy.init_node(NODE, argv=["", *args.ros_arguments])
    servers = RecognitionServers(recognizers, find_camera(args), messages)
    origin = "the workspace" if messages.installed else "ZeroShOP's copy"
    print(f"{', '.join(recognizers)} know {', '.join(store.objects)}; messages of {origin}", flush=True)
    rospy.spin()
    del servers


def find_camera(args: argparse.Namespace) -> CameraSource:
    """Where the camera matrix comes from. Raises StepError where nothing says it."""
    import rospy

    if args.intrinsics:
        return GivenCamera(*args.intrinsics)
    topic = args.camera_info_topic or rospy.get_param(PARAMETER, None)
    if not topic:
        raise StepError(
            f"where is the camera matrix? Goals have none. Set the parameter {PARAMETER}, or give --camera-info-topic or --intrinsics"
        )
    return TopicCamera(topic)
