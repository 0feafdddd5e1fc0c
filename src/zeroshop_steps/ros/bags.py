"""What all who read bags share."""

import importlib.util
from typing import Any

from zeroshop_steps.runtime.errors import StepError

RECTIFIED = "rect"
"""In the name of a topic whose images image_proc has undistorted, such as image_rect_color; its camera message is the same."""
MOST_APART_NS = 20_000_000  # of the stamps of colour and depth; cameras take 30 pairs a second


def require_rosbags() -> None:
    """Raises StepError where the package that reads and writes bags is missing."""
    if importlib.util.find_spec("rosbags") is None:
        raise StepError("bags need the package rosbags: pip install 'zeroshop[robot]'")


def stamp_of(message: Any) -> int:
    """When a message's image was taken, in ns; rospy calls the parts of a time otherwise than ROS 2 and rosbags do."""
    stamp = message.header.stamp
    parts = (stamp.sec, stamp.nanosec) if hasattr(stamp, "sec") else (stamp.secs, stamp.nsecs)
    return int(parts[0]) * 10**9 + int(parts[1])
