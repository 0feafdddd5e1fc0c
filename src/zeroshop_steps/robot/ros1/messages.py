"""The classes of robokudo_msgs/GenericImgProcAnnotator: those of the user's workspace, otherwise made here from the action's file."""

import importlib
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zeroshop_steps.robot.goals import MessageTypes
from zeroshop_steps.runtime.errors import StepError

PACKAGE, NAME = "robokudo_msgs", "GenericImgProcAnnotator"
ACTION_FILE = Path(__file__).parents[1] / f"{NAME}.action"
SEPARATOR = "\n" + "=" * 80 + "\n"
# What actionlib makes of an action (http://wiki.ros.org/actionlib, section 2.1).
WRAPPERS = {
    "ActionGoal": "Header header\nactionlib_msgs/GoalID goal_id\n{name}Goal goal\n",
    "ActionResult": "Header header\nactionlib_msgs/GoalStatus status\n{name}Result result\n",
    "ActionFeedback": "Header header\nactionlib_msgs/GoalStatus status\n{name}Feedback feedback\n",
}
WHOLE = "{name}ActionGoal action_goal\n{name}ActionResult action_result\n{name}ActionFeedback action_feedback\n"


@dataclass(frozen=True)
class ActionMessages:
    """Classes of messages.

    Attributes:
        action, goal: of robokudo_msgs.
        types: of which results are made.
        installed: whether they are those of the user's workspace.
    """

    action: Any
    goal: Any
    types: MessageTypes
    installed: bool


def load_messages() -> ActionMessages:
    """The messages of the action; ROS must be there (environment.py).

    Raises:
        StepError: the installed robokudo_msgs has other fields than the action's file.
    """
    from geometry_msgs.msg import Pose
    from sensor_msgs.msg import Image, RegionOfInterest

    made = make_messages()
    installed = importlib.util.find_spec(PACKAGE) is not None
    if installed:
        module = importlib.import_module(f"{PACKAGE}.msg")
        classes: dict[str, Any] = {part: getattr(module, f"{NAME}{part}", None) for part in ("Action", "Goal", "Result")}
        for part, found in classes.items():
            if found is None or found._md5sum != made[part]._md5sum:
                raise StepError(
                    f"{module.__file__} has another {NAME}{part} than {ACTION_FILE}; robots and servers would not understand each other:"
                    " update robokudo_msgs in your workspace"
                )
    else:
        classes = made
    return ActionMessages(classes["Action"], classes["Goal"], MessageTypes(classes["Result"], Image, RegionOfInterest, Pose), installed)


def make_messages() -> dict[str, Any]:
    """The seven classes of the action by what follows its name, such as Goal and ActionGoal, made in memory by ROS's own generator."""
    import actionlib_msgs.msg
    import genpy.dynamic
    import geometry_msgs.msg
    import sensor_msgs.msg

    used = (sensor_msgs.msg.Image, sensor_msgs.msg.RegionOfInterest, geometry_msgs.msg.Pose, actionlib_msgs.msg.GoalStatus)
    texts: dict[str, str] = {}
    for message in used:
        first, *others = message._full_text.split(SEPARATOR)
        texts[message._type] = first
        texts |= {head.removeprefix("MSG: "): text for head, text in (other.split("\n", 1) for other in others)}
    parts = dict(zip(("Goal", "Result", "Feedback"), split_action(ACTION_FILE.read_text()), strict=True))
    parts |= {part: text.format(name=NAME) for part, text in WRAPPERS.items()}
    texts |= {f"{PACKAGE}/{NAME}{part}": text for part, text in parts.items()}
    whole = SEPARATOR.join([WHOLE.format(name=NAME), *(f"MSG: {name}\n{text}" for name, text in texts.items())])
    classes = genpy.dynamic.generate_dynamic(f"{PACKAGE}/{NAME}Action", whole)
    return {part: classes[f"{PACKAGE}/{NAME}{part}"] for part in ("Action", *parts)}


def split_action(text: str) -> list[str]:
    """Goal, result and feedback of an action's file."""
    parts: list[list[str]] = [[]]
    for line in text.splitlines():
        if line.strip() == "---":
            parts.append([])
        else:
            parts[-1].append(line)
    return ["\n".join(lines) + "\n" for lines in parts]
