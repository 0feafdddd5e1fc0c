"""Publish the camera matrix of a scene's first image on /camera/rgb/camera_info until the end: ros1_camera.py SCENE_FOLDER"""

import sys
from pathlib import Path

from zeroshop_steps.bop.scene import read_scene
from zeroshop_steps.robot.ros1.environment import provide_ros


def main(scene: Path) -> None:
    provide_ros()
    import rospy
    from sensor_msgs.msg import CameraInfo

    frame = next(iter(read_scene(scene).values()))
    height, width = frame.color().shape[:2]
    rospy.init_node("camera", argv=[""])
    publisher = rospy.Publisher("/camera/rgb/camera_info", CameraInfo, queue_size=1, latch=True)
    publisher.publish(CameraInfo(width=width, height=height, K=frame.intrinsics.ravel().tolist()))
    rospy.spin()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
