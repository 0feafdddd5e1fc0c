"""Send many goals to an action server of ROS 1, and tell what the server's process holds before and after.

`python benchmarks/ros1_goals.py --goals 1000` starts a roscore and a server with a stand-in estimator, so that the messages' way alone is
measured: images of 64 x 48 px, now and then a new client, as the grasping pipeline makes one for each goal, and every fifth goal a bad one.
`--models FOLDER --scene FOLDER` serves render_compare instead, with goals from a BOP scene's first image and its true masks.
"""

import argparse
import ctypes
import gc
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.robot.goal_camera import FixedCamera
from zeroshop_steps.robot.object_store import ObjectStore
from zeroshop_steps.robot.recognition import Recognition, RecognitionRequest, RecognizedObject, make_frame
from zeroshop_steps.robot.recognizers import make_recognizers
from zeroshop_steps.robot.ros1.environment import provide_ros
from zeroshop_steps.robot.ros1.messages import ActionMessages, load_messages
from zeroshop_steps.robot.ros1_servers import RecognitionServers
from zeroshop_steps.ros.image_messages import write_image

WIDTH, HEIGHT = 64, 48
STAND_IN, REAL = "/pose_estimator/stand_in", "/pose_estimator/render_compare"
BAD = 5  # every so many goals
FORGET_S = 7.0  # until actionlib has forgotten goals that were answered
WARM_UP = 20  # goals before the first measurement, in which buffers and caches grow


class StandIn:
    """Says that each mask is where it was; everything else is as for a real estimator."""

    def prepare(self) -> None:
        """Nothing to take."""

    def recognize(self, request: RecognitionRequest) -> Recognition:
        """One object for each mask."""
        make_frame(request)
        objects = [RecognizedObject("mug", 1, 0.5, (0, 0, 9, 9), mask, np.eye(4), "stand-in") for mask in request.masks]
        return Recognition(tuple(objects))


def serve(args: argparse.Namespace) -> None:
    """Be the server."""
    provide_ros()
    import rospy

    if args.models:
        intrinsics = first_frame(args.scene).intrinsics
        recognizers = make_recognizers([], ["render_compare"], ObjectStore(args.models, objects=args.objects), {})
    else:
        intrinsics, recognizers = np.array([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]]), {STAND_IN: StandIn()}
    for recognizer in recognizers.values():
        recognizer.prepare()
    signal.signal(signal.SIGUSR1, lambda number, frame: print(tell_blocks(), flush=True))
    rospy.init_node("servers", argv=[""])
    camera = FixedCamera(*intrinsics[[0, 1], [0, 1]], *intrinsics[:2, 2])
    servers = RecognitionServers(recognizers, camera, load_messages())
    rospy.spin()
    del servers


def tell_blocks() -> int:
    """How many blocks of memory Python's objects have; memory that the C library keeps for later goes back to the system."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return sys.getallocatedblocks()


def first_frame(scene: Path) -> Any:
    """The first image of a BOP scene."""
    return next(iter(read_scene(scene).values()))


def make_goals(args: argparse.Namespace, messages: ActionMessages) -> tuple[Any, Any]:
    """A goal that is answered, and one whose depth is missing."""
    from std_msgs.msg import Header

    image, header, good, bad = messages.types.image, Header(), messages.goal(), messages.goal()
    if args.models:
        frame, listed = first_frame(args.scene), ObjectStore(args.models, objects=args.objects)
        photo, depth = frame.color(), frame.depth_mm() / 1000
        pairs = [(frame.mask(index), one.object_id) for index, one in enumerate(frame.instances) if one.object_id in listed.models]
        masks, names = [mask for mask, _ in pairs], [listed.name_of(number) for _, number in pairs]
    else:
        photo, depth = np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.ones((HEIGHT, WIDTH), np.float32)
        masks, names = [np.ones((HEIGHT, WIDTH), bool)] * 3, ["mug"] * 3
    for goal in (good, bad):
        goal.rgb = write_image(image, photo, "rgb8", header)
        goal.mask_detections = [write_image(image, mask.astype(np.uint8), "8UC1", header) for mask in masks]
        goal.class_names = names
    good.depth = write_image(image, depth.astype(np.float32), "32FC1", header)
    bad.depth = write_image(image, np.zeros(depth.shape, np.float32), "32FC1", header)
    return good, bad


def held_by(pid: int) -> dict[str, float]:
    """What a process holds: resident memory in MB, threads, open files; and the CPU seconds that it has used."""
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines() if ":\t" in line)
    times = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    cpu_s = sum(map(int, times)) / os.sysconf("SC_CLK_TCK")
    files = len(os.listdir(f"/proc/{pid}/fd"))
    return {"MB": int(status["VmRSS"].split()[0]) / 1024, "threads": int(status["Threads"]), "files": files, "cpu_s": cpu_s}


def send(args: argparse.Namespace, server: subprocess.Popen) -> None:
    """Send the goals and print what the server holds on the way."""
    provide_ros()
    import actionlib
    import rospy

    rospy.init_node("client", argv=[""], disable_signals=True)
    messages = load_messages()
    good, bad = make_goals(args, messages)
    client, right = None, 0
    for index in range(-args.warm_up, args.goals + 1):
        if client is None or index % args.new_client == 0:
            client = actionlib.SimpleActionClient(REAL if args.models else STAND_IN, messages.action)
            assert client.wait_for_server(rospy.Duration(600))
        if index >= 0 and index % max(args.goals // 4, 1) == 0:
            time.sleep(FORGET_S)
            server.send_signal(signal.SIGUSR1)
            blocks = server.stdout.readline().strip()
            held = held_by(server.pid)
            print(f"after {index} goals: {blocks} blocks, " + ", ".join(f"{value:.1f} {name}" for name, value in held.items()), flush=True)
        if index == args.goals:
            break
        is_bad = index % BAD == 0
        client.send_goal(bad if is_bad else good)
        assert client.wait_for_result(rospy.Duration(600)), "no answer"
        result = client.get_result()
        right += index >= 0 and result.success != is_bad and (is_bad or len(result.pose_results) == len(good.class_names))
    print(f"{right} of {args.goals} answers are as expected")


def main() -> None:
    """Start everything, send, and end everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", type=int, default=1000)
    parser.add_argument("--warm-up", type=int, default=WARM_UP)
    parser.add_argument("--new-client", type=int, default=10, help="after so many goals (default: %(default)s)")
    parser.add_argument("--models", type=Path)
    parser.add_argument("--objects", nargs="*", default=[])
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args)
        return
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": folder, "ROS_HOME": folder}
        core = subprocess.Popen(["roscore", "-p", str(port)], stdout=subprocess.DEVNULL)
        provide_ros()
        import rosgraph

        while not rosgraph.is_master_online():
            time.sleep(0.2)
        server = subprocess.Popen(
            [sys.executable, __file__, "--serve", *sys.argv[1:]], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        try:
            send(args, server)
        finally:
            for process in (server, core):
                process.terminate()
                process.wait(30)


if __name__ == "__main__":
    main()
