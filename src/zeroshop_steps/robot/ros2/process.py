"""A process with one node of ROS 2, from the check that ROS 2 is there to its end."""

import importlib.util
from collections.abc import Callable, Sequence
from typing import Any

from zeroshop_steps.runtime.errors import StepError


def require_packages(needed: Sequence[str], also: str = "") -> None:
    """Raise StepError where a package of ROS 2 is missing; `also` ends the remedy."""
    lacking = [name for name in needed if importlib.util.find_spec(name) is None]
    if lacking:
        raise StepError(
            f"ROS 2 is not complete here: {', '.join(lacking)} cannot be imported. Source ROS 2's setup.bash, in a shell whose Python has"
            f" the version of this environment{also}"
        )


def serve(name: str, start: Callable[[Any], Sequence[Any]], ready: str) -> None:
    """Run a node until ROS shuts down.

    Args:
        name: of the node.
        start: is given it, and returns what must be destroyed before it.
        ready: is printed when it serves.
    """
    import rclpy
    from rclpy.executors import MultiThreadedExecutor

    rclpy.init()
    node = rclpy.create_node(name)
    parts = start(node)
    print(ready, flush=True)
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    finally:
        for part in parts:
            part.destroy()
        node.destroy_node()
        rclpy.try_shutdown()
