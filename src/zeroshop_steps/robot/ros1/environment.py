"""ROS 1 in the project's own Python.

ROS's packages for Python are plain Python, and Debian 12 has them for the Python version of this environment. So a server is one process
with the project's packages, which finds ROS's beside them: in a sourced workspace (PYTHONPATH), otherwise in Debian's folder. From there
ROS's packages alone are taken: others, made for another NumPy, would crash this process.
"""

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

from zeroshop_steps.runtime.errors import StepError

DEBIAN_FOLDER = "/usr/lib/python3/dist-packages"
DEBIAN_PACKAGES = ("python3-rospy", "python3-roslaunch", "python3-rosmaster", "python3-actionlib", "python3-sensor-msgs", "rosout")
INSTALL = f"sudo apt-get install {' '.join(DEBIAN_PACKAGES)}"
FROM_DEBIAN = frozenset(
    {"rospy", "roslib", "roscpp", "rosgraph", "rospkg", "actionlib", "genpy", "genmsg", "catkin", "catkin_pkg", "netifaces", "defusedxml"}
    | {"std_msgs", "std_srvs", "rosgraph_msgs", "actionlib_msgs", "geometry_msgs", "sensor_msgs"}
)
"""What rospy, actionlib and the messages import, and this environment lacks."""


class DebianRos:
    """Finds ROS's packages in Debian's folder, where nothing else has them."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Of a top-level package of ROS; None of all others."""
        return PathFinder.find_spec(name, [DEBIAN_FOLDER], target) if path is None and name in FROM_DEBIAN else None


def provide_ros(*more: str) -> None:
    """Make `import rospy` and its kin work in this process.

    Args:
        more: other packages of ROS that are needed.

    Raises:
        StepError: ROS 1 is not installed, or one of these.
    """
    if DebianRos not in sys.meta_path:
        sys.meta_path.append(DebianRos)
    lacking = [name for name in ("rospy", "actionlib", "sensor_msgs", "rosgraph", *more) if importlib.util.find_spec(name) is None]
    if lacking:
        raise StepError(
            f"ROS 1 is not installed: {', '.join(lacking)} cannot be found. Source your workspace, or install Debian's packages:"
            f" {' '.join([INSTALL, *(f'python3-{name}'.replace('_', '-') for name in more)])}"
        )


def require_master() -> None:
    """Raises StepError where no roscore answers; rospy would wait for it without an end."""
    import rosgraph

    if not rosgraph.is_master_online():
        raise StepError(f"no roscore answers at {rosgraph.get_master_uri()}; start one with: roscore. ROS_MASTER_URI names another place")
