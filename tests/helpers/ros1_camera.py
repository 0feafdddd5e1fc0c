"""Publish a scene's first image, its depth and its camera matrix below /camera until the end: ros1_camera.py SCENE_FOLDER"""

import sys
from pathlib import Path

import numpy as np

from zeroshop_steps.bop.formats.bop_scenes import read_scene
from zeroshop_steps.robot.ros1.environment import provide_ros
from zeroshop_steps.ros.image_messages import write_image


def main(scene: Path) -> None:
    provide_ros()
    import rospy
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Header

    frame = next(iter(read_scene(scene).values()))
    height, width = frame.color().shape[:2]
    rospy.init_node("camera", argv=[""])
    publisher = rospy.Publisher("/camera/rgb/camera_info", CameraInfo, queue_size=1, latch=True)
    publisher.publish(CameraInfo(width=width, height=height, K=frame.intrinsics.ravel().tolist()))
    images = {"rgb": (frame.color(), "rgb8"), "depth": (frame.depth_mm().astype(np.float32) / np.float32(1000), "32FC1")}
    latched = []
    for name, (pixels, encoding) in images.items():
        latched.append(rospy.Publisher(f"/camera/{name}/image_raw", Image, queue_size=1, latch=True))
        latched[-1].publish(write_image(Image, pixels, encoding, Header()))
    rospy.spin()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
