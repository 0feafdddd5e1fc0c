"""Send goals that cannot be answered, and then a good one, to /pose_estimator/render_compare; print what came back as JSON.

A process of its own, as a node of ROS is one for its process: ros1_bad_goals.py SCENE_FOLDER
"""

import copy
import json
import sys
from pathlib import Path

import cv2
import numpy as np

from helpers.painted_scene import CARTON
from zeroshop_steps.geometry.imaging.images import decode_image, read_image, read_mask
from zeroshop_steps.robot.ros1.environment import provide_ros
from zeroshop_steps.robot.ros1.messages import load_messages
from zeroshop_steps.robot.ros1_goal import STATES
from zeroshop_steps.ros.image_messages import write_image


def main(scene: Path) -> None:
    provide_ros()
    import actionlib
    import rospy
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header

    rospy.init_node("bad_goals", disable_signals=True)
    messages, header = load_messages(), Header()
    good = messages.goal()
    good.rgb = write_image(Image, read_image(scene / "rgb/000000.png"), "rgb8", header)
    good.depth = write_image(Image, decode_image(scene / "depth/000000.png", cv2.IMREAD_UNCHANGED), "16UC1", header)
    good.mask_detections = [write_image(Image, read_mask(scene / "mask_visib/000000_000000.png").astype(np.uint8), "8UC1", header)]
    good.class_names = [f"obj_{CARTON:06d}"]
    no_depth = np.full((good.rgb.height, good.rgb.width), np.nan, np.float32)
    changes = {
        "no depth": {"depth": Image()},
        "no colours": {"rgb": Image()},
        "wrong encoding": {"rgb": write_image(Image, np.zeros((240, 320, 2), np.uint8), "8UC2", header)},
        "short data": {"rgb": Image(height=240, width=320, encoding="rgb8", step=960, data=b"0123456789")},
        "other size": {"depth": write_image(Image, np.ones((3, 4), np.float32), "32FC1", header)},
        "all NaN": {"depth": write_image(Image, no_depth, "32FC1", header)},
        "empty mask": {"mask_detections": [write_image(Image, np.zeros((240, 320), np.uint8), "mono8", header)]},
        "unknown name": {"class_names": ["teapot"]},
        "no names": {"class_names": []},
        "good": {},
    }
    client = actionlib.SimpleActionClient("/pose_estimator/render_compare", messages.action)
    assert client.wait_for_server(rospy.Duration(30))
    told = {}
    for name, changed in changes.items():
        goal = copy.copy(good)
        for field, value in changed.items():
            setattr(goal, field, value)
        client.send_goal_and_wait(goal, rospy.Duration(120))
        result = client.get_result()
        told[name] = {"state": STATES[client.get_state()], "success": result.success}
        told[name] |= {"feedback": result.result_feedback, "status": client.get_goal_status_text()}
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
