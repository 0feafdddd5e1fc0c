"""An arm that stands still with a camera on it, in ROS 1: it publishes, asks the scan's services, and prints what they answer as JSON."""

import json
import sys
import threading

import numpy as np
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.robot.ros1.environment import provide_ros
from zeroshop_steps.robot.scan_ros1 import find_transforms
from zeroshop_steps.ros.image_messages import write_image

WIDTH, HEIGHT, OPTICAL = 160, 120, "camera_optical"
CENTRE = np.array([0.6, 0.0, 0.1])


def main() -> None:
    provide_ros()
    import rospy
    from geometry_msgs.msg import PoseStamped, TransformStamped
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Header
    from std_srvs.srv import Trigger

    rospy.init_node("arm", argv=[""])
    kinds = {"/tf": find_transforms(), "/camera/image": Image, "/camera/depth": Image, "/camera/info": CameraInfo}
    send = {topic: rospy.Publisher(topic, kind, queue_size=10).publish for topic, kind in kinds.items()}
    pixels = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    base_from_camera = np.linalg.inv(look_at(CENTRE + 0.35 * direction_at(np.pi, np.radians(40.0)), CENTRE))

    def publish() -> None:
        while not rospy.is_shutdown():
            now = rospy.Time.now()
            one = TransformStamped(header=Header(stamp=now, frame_id="base"), child_frame_id=OPTICAL)
            place, turn = one.transform.translation, one.transform.rotation
            place.x, place.y, place.z = base_from_camera[:3, 3].tolist()
            turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(base_from_camera[:3, :3]).as_quat().tolist()
            header = Header(stamp=now, frame_id=OPTICAL)
            send["/tf"](kinds["/tf"](transforms=[one]))
            send["/camera/info"](CameraInfo(header=header, width=WIDTH, height=HEIGHT, K=[150, 0, 79.5, 0, 150, 59.5, 0, 0, 1]))
            send["/camera/depth"](write_image(Image, np.full((HEIGHT, WIDTH), 0.35, np.float32), "32FC1", header))
            send["/camera/image"](write_image(Image, pixels, "rgb8", header))
            rospy.sleep(0.05)

    threading.Thread(target=publish, daemon=True).start()
    rospy.wait_for_service("/zeroshop_scan/record", 100)
    rospy.sleep(2.0)
    answers = {}
    for name in ("record", "next_view"):
        answer = rospy.ServiceProxy(f"/zeroshop_scan/{name}", Trigger)()
        answers[name] = [answer.success, answer.message]
    view = rospy.wait_for_message("/zeroshop_scan/viewpoint", PoseStamped, 20)
    answers["viewpoint"] = [view.header.frame_id, view.pose.position.x, view.pose.position.y, view.pose.position.z]
    json.dump(answers, sys.stdout)


if __name__ == "__main__":
    main()
