"""Messages of ROS 2 without ROS 2: the package rosbags has their definitions, and the action's result is made from its file."""

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from zeroshop_steps.robot.goals import MessageTypes
from zeroshop_steps.robot.ros1.messages import ACTION_FILE, split_action
from zeroshop_steps.ros.bags import require_rosbags

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

RESULT = "robokudo_msgs/msg/GenericImgProcAnnotatorResult"


@functools.cache
def message_store() -> "Typestore":
    """The types of messages, with the action's result as a message."""
    require_rosbags()
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(split_action(ACTION_FILE.read_text())[1], RESULT))
    return store


def blank(name: str) -> Any:
    """A message of this type whose numbers are 0 and whose texts and lists are empty."""
    kind = message_store().types[name]
    return kind(**{name: _zero(definition) for name, definition in message_store().fielddefs[kind.__msgtype__][1]})


def _zero(definition: Any) -> Any:
    """The zero of a field, by rosbags' definition of it: a kind, and what it is of."""
    from rosbags.interfaces import Nodetype

    kind, detail = definition
    if kind == Nodetype.BASE:
        return "" if detail[0] == "string" else False if detail[0] == "bool" else np.dtype(detail[0]).type(0).item()
    if kind == Nodetype.NAME:
        return blank(detail)
    (inner, inner_detail), length = detail
    if kind == Nodetype.SEQUENCE:
        length = 0
    if inner == Nodetype.BASE and inner_detail[0] != "string":
        return np.zeros(length, inner_detail[0])
    return [_zero(detail[0]) for _ in range(length)]


def bag_types() -> MessageTypes:
    """Makers of the messages that results consist of."""
    parts = (RESULT, "sensor_msgs/msg/Image", "sensor_msgs/msg/RegionOfInterest", "geometry_msgs/msg/Pose")
    return MessageTypes(*(functools.partial(blank, part) for part in parts))
