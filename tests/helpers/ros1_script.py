"""Run a script of the ROS package as a workspace with robokudo_msgs would: ros1_script.py SCRIPT WORDS..."""

import runpy
import sys
from types import ModuleType

from zeroshop_steps.robot.ros1.environment import provide_ros


def main(script: str) -> None:
    provide_ros()
    from zeroshop_steps.robot.ros1.messages import NAME, PACKAGE, make_messages

    package, messages = ModuleType(PACKAGE), ModuleType(f"{PACKAGE}.msg")
    for part, made in make_messages().items():
        setattr(messages, f"{NAME}{part}", made)
    sys.modules |= {PACKAGE: package, f"{PACKAGE}.msg": messages}
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    sys.argv = sys.argv[1:]
    main(sys.argv[0])
