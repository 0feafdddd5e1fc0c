"""A client of the action servers."""

import time
from typing import Any

from zeroshop_steps.runtime.errors import StepError

LOOK_S = 0.5  # between looks at the goal itself: the client may not have been told of an answer that came at once
STATES = ("pending", "active", "preempted", "succeeded", "aborted", "rejected", "preempting", "recalling", "recalled", "lost")
"""By the numbers of actionlib_msgs/GoalStatus."""


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
