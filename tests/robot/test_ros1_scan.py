"""The scan by ROS 1 end to end: a roscore, the node, and an arm as processes of their own."""

import importlib.util
import json
import subprocess
import sys

import pytest

from helpers.paths import REPOSITORY
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.geometry.imaging.images import list_images
from zeroshop_steps.robot.ros1.environment import provide_ros


@pytest.mark.slow
def test_a_view_is_recorded_and_the_next_one_proposed(roscore, tmp_path):
    provide_ros()
    if importlib.util.find_spec("std_srvs") is None:
        pytest.skip("python3-std-srvs is not installed")
    topics = ["--image-topic", "/camera/image", "--camera-info-topic", "/camera/info", "--depth-topic", "/camera/depth"]
    words = [*topics, "--box", "0.6", "0", "0.1", "0.2", "0.2", "0.2", "--reach-m", "1.3", "--out", str(tmp_path / "scan")]
    log = (tmp_path / "log").open("w")
    command = [sys.executable, "-m", "zeroshop_steps.robot", "--method", "scan_ros1", *words]
    node = subprocess.Popen(command, env=roscore, stdout=log, stderr=subprocess.STDOUT)
    try:
        arm = subprocess.run(
            [sys.executable, REPOSITORY / "tests/helpers/ros1_arm.py"], env=roscore, capture_output=True, text=True, timeout=300
        )
    finally:
        node.terminate()
        node.wait(60)
    assert arm.returncode == 0, arm.stderr + (tmp_path / "log").read_text()
    answers = json.loads(arm.stdout)
    assert answers["record"][0], answers["record"]
    assert answers["next_view"][0] and answers["viewpoint"][0] == "base", answers
    given = read_given_cameras(tmp_path / "scan/cameras.json")
    assert len(given.poses) == 1 and len(list_images(tmp_path / "scan/depth")) == 1
