"""Models that are rendered and reconstructed small, and a roscore on a free port of this machine."""

import os
import shutil
import socket
import subprocess
import time

import pytest

from helpers.painted_scene import write_painted_dataset
from helpers.scan_messages import make_placed_node

START_S = 60  # for roscore on a busy machine


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """The painted carton and can (painted_scene.py)."""
    return write_painted_dataset(tmp_path_factory.mktemp("painted"))


@pytest.fixture(scope="session")
def roscore(tmp_path_factory):
    """The environment of processes that talk to a roscore of this test run, which listens on this machine alone."""
    if shutil.which("roscore") is None:
        pytest.skip("ROS 1 is not installed; .ci/run names Debian's packages")
    folder = tmp_path_factory.mktemp("ros")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    own = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(folder), "ROS_HOME": str(folder)}
    own["PYTHONUNBUFFERED"] = "1"  # else what tells that they run stays in the buffers of their logs
    environment = os.environ | own
    with (folder / "roscore.log").open("w") as log:
        process = subprocess.Popen(["roscore", "-p", str(port)], env=environment, stdout=log, stderr=subprocess.STDOUT)
    try:
        end_s = time.monotonic() + START_S
        while "started core service" not in (folder / "roscore.log").read_text():
            assert process.poll() is None and time.monotonic() < end_s, (folder / "roscore.log").read_text()
            time.sleep(0.2)
        yield environment
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture
def node(tmp_path):
    """A scan's node that knows how its camera is mounted, and its lens."""
    return make_placed_node(tmp_path)
