"""Action servers of ROS 1, one for each recognizer."""

import threading
import time
from typing import Any

from zeroshop_steps.robot.goal_camera import CameraSource
from zeroshop_steps.robot.goals import answer_goal
from zeroshop_steps.robot.recognizers import Recognizer
from zeroshop_steps.robot.ros1.messages import ActionMessages

LEAST_S = 0.05
"""From a goal to its answer. actionlib's client for Python loses an answer that comes while it still notes the goal, and waits without
an end: of 1,000 goals that were answered at once, some were lost."""


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
