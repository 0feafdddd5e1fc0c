"""Send one goal from files to an action server of ROS 1, and write what it answers.

Writes result.json (names, confidences, boxes, poses) and, for each object, its mask as PNG, which the next goal can take: the masks that
a detector found are those of an estimator's goal. Ends with an error where the server refuses. Needs ROS 1 and a running roscore.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zeroshop_steps.geometry.imaging.depth_images import depth_to_mm
from zeroshop_steps.geometry.imaging.images import decode_image, read_image, read_mask, write_mask
from zeroshop_steps.robot.goals import BACKGROUND, read_pose
from zeroshop_steps.robot.ros1.environment import provide_ros, require_master
from zeroshop_steps.robot.ros1.messages import load_messages
from zeroshop_steps.ros.image_messages import write_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import atomic_directory, write_json

LOOK_S = 0.5  # between looks at the goal itself: the client may not have been told of an answer that came at once
STATES = ("pending", "active", "preempted", "succeeded", "aborted", "rejected", "preempting", "recalling", "recalled", "lost")
"""By the numbers of actionlib_msgs/GoalStatus."""
NODE = "zeroshop_goal"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The method's command line."""
    parser.add_argument("--server", required=True, help="such as /object_detector/contour or /pose_estimator/render_compare")
    parser.add_argument("--rgb", type=Path, required=True, help="colour image")
    parser.add_argument("--depth", type=Path, help="16-bit depth image, aligned with it")
    parser.add_argument("--depth-scale", type=float, default=1.0, help="millimetres of one step of the depth image (default: %(default)s)")
    parser.add_argument("--class-names", nargs="*", default=[], help="objects to look for, or the object in each mask")
    parser.add_argument("--masks", type=Path, nargs="*", default=[], help="masks of the objects, in the order of their names")
    parser.add_argument("--timeout-s", type=float, default=300.0, help="for the answer (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")


def run(args: argparse.Namespace) -> None:
    """Send the goal and write the answer."""
    provide_ros()
    require_master()
    import rospy

    messages = load_messages()
    rospy.init_node(NODE, anonymous=True, argv=[""], disable_signals=True)
    goal = make_goal(args, messages.goal)
    state, result, seconds = send_goal(args.server, messages.action, goal, args.timeout_s)
    if not result.success:
        raise StepError(f"{args.server} refused the goal: {result.result_feedback}")
    with atomic_directory(args.out) as folder:
        write_answer(folder, result, seconds)
    print(f"{args.out}: {len(result.class_names)} objects in {seconds:.2f} s, {state}")


def make_goal(args: argparse.Namespace, goal_class: Any) -> Any:
    """The goal's message from files. Raises StepError where one cannot be read."""
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header

    goal, header = goal_class(), Header()
    goal.rgb = write_image(Image, read_image(args.rgb), "rgb8", header)
    if args.depth:
        raw = decode_image(args.depth, cv2.IMREAD_UNCHANGED)
        if raw.ndim != 2:
            raise StepError(f"{args.depth} has {raw.shape[2]} channels; expected depth in one channel of 16 bits")
        goal.depth = write_image(Image, depth_to_mm(raw, args.depth_scale, str(args.depth)) / np.float32(1000), "32FC1", header)
    goal.mask_detections = [write_image(Image, read_mask(path).astype(np.uint8) * 255, "mono8", header) for path in args.masks]
    goal.class_names = list(args.class_names)
    return goal


def write_answer(folder: Path, result: Any, seconds: float) -> None:
    """Write result.json and the masks of the objects."""
    labels = np.frombuffer(result.image.data, "<i2").reshape(result.image.height, result.image.width)
    objects = []
    for index, name in enumerate(result.class_names):
        write_mask(folder / f"mask_{index:06d}.png", (labels == index) & (labels != BACKGROUND))
        box = result.bounding_boxes[index]
        entry = {
            "name": name,
            "object_id": int(result.class_ids[index]),
            "confidence": float(result.class_confidences[index]),
            "box_px": [box.x_offset, box.y_offset, box.width, box.height],
            "description": result.descriptions[index],
        }
        if result.pose_results:
            entry["camera_from_model_mm"] = read_pose(result.pose_results[index]).tolist()
        objects.append(entry)
    write_json(folder / "result.json", {"seconds": round(seconds, 3), "feedback": result.result_feedback, "objects": objects})


def send_goal(server: str, action: Any, goal: Any, timeout_s: float) -> tuple[str, Any, float]:
    """Send a goal and wait for the answer.

    Returns:
        How the goal ended, the result's message, and the seconds from sending to the answer.

    Raises:
        StepError: there is no such server, or it does not answer in time.
    """
    import actionlib
    import rospy

    client = actionlib.SimpleActionClient(server, action)
    # A server may not be there yet.
    if not client.wait_for_server(rospy.Duration.from_sec(10.0)):
        raise StepError(f"there is no action server {server}; rostopic list names those that run")
    start_s = time.monotonic()
    client.send_goal(goal)
    while not client.wait_for_result(rospy.Duration.from_sec(LOOK_S)) and client.gh.get_comm_state() != actionlib.CommState.DONE:
        if time.monotonic() - start_s < timeout_s:
            continue
        client.cancel_goal()
        raise StepError(f"{server} has not answered within {timeout_s:g} s; see its log, or give it longer with --timeout-s")
    seconds = time.monotonic() - start_s
    return STATES[client.gh.get_terminal_state()], client.get_result(), seconds
