"""Action servers of ROS 2, one for each recognizer.

rclpy is asked for as little as possible: everything else is shared with ROS 1 and is tested without it.
"""

import threading
from typing import Any

from zeroshop_steps.robot.goal_camera import CameraSource
from zeroshop_steps.robot.goals import MessageTypes, answer_goal
from zeroshop_steps.robot.recognizers import Recognizer


class GoalExecutor:
    """Answers the goals of one server. All executors of a process share a lock, so that goals are computed one after the other."""

    def __init__(self, recognizer: Recognizer, camera: CameraSource, types: MessageTypes, turn: threading.Lock, logger: Any) -> None:
        self.recognizer, self.camera, self.types, self._turn, self._logger = recognizer, camera, types, turn, logger

    def __call__(self, goal_handle: Any) -> Any:
        """The result of a goal, whose handle is told whether it succeeded (rclpy's execute_callback)."""
        with self._turn:
            answer = answer_goal(goal_handle.request, self.recognizer, self.camera.intrinsics_of, self.types)
        if answer.succeeded:
            goal_handle.succeed()
        else:
            self._logger.warning(f"a goal was refused: {answer.reason}")
            goal_handle.abort()
        return answer.result


def start_servers(node: Any, recognizers: dict[str, Recognizer], camera: CameraSource) -> list[Any]:
    """The action servers of a node, whose executor must have several threads: the camera's messages come while goals are computed."""
    from geometry_msgs.msg import Pose
    from rclpy.action import ActionServer
    from rclpy.callback_groups import ReentrantCallbackGroup
    from robokudo_msgs.action import GenericImgProcAnnotator
    from sensor_msgs.msg import Image, RegionOfInterest

    types, turn, group = (
        MessageTypes(GenericImgProcAnnotator.Result, Image, RegionOfInterest, Pose),
        threading.Lock(),
        ReentrantCallbackGroup(),
    )
    return [
        ActionServer(
            node,
            GenericImgProcAnnotator,
            name,
            execute_callback=GoalExecutor(recognizer, camera, types, turn, node.get_logger()),
            callback_group=group,
        )
        for name, recognizer in recognizers.items()
    ]
