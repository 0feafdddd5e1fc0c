"""ROS 1 end to end: a roscore, the servers and clients as processes of their own, on this machine alone."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest

from helpers.painted_scene import CAN, CARTON
from helpers.paths import REPOSITORY
from zeroshop_steps.geometry.imaging.images import read_mask

pytestmark = pytest.mark.slow
START_S = 120
CARTON_NAME, CAN_NAME = f"obj_{CARTON:06d}", f"obj_{CAN:06d}"


def robot(environment: dict, *words) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "zeroshop_steps.robot", "--method", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def servers(roscore, dataset, tmp_path_factory):
    """The servers of the painted models, started by the launch file, and a camera: the process of roslaunch and its log."""
    log = tmp_path_factory.mktemp("servers") / "log"
    words = [f"models:={dataset.folder / 'models'}", f"python:={sys.executable}"]
    environment = roscore | {"ROS_PACKAGE_PATH": str(REPOSITORY / "ros")}
    camera = subprocess.Popen([sys.executable, REPOSITORY / "tests/helpers/ros1_camera.py", dataset.scene], env=roscore)
    with log.open("w") as file:
        process = subprocess.Popen(
            ["roslaunch", "zeroshop", "servers.launch", *words], env=environment, stdout=file, stderr=subprocess.STDOUT
        )
    try:
        end_s = time.monotonic() + START_S
        while "are ready" not in log.read_text():
            assert process.poll() is None and time.monotonic() < end_s, log.read_text()
            time.sleep(0.2)
        yield process, log
    finally:
        for one in (process, camera):
            one.terminate()
            one.wait(60)
    assert "[zeroshop_recognition-1] killing on exit" in log.read_text() and "escalating" not in log.read_text(), log.read_text()


def test_a_goal_is_detected_and_posed(servers, roscore, dataset, tmp_path):
    images = ["--rgb", dataset.scene / "rgb/000000.png", "--depth", dataset.scene / "depth/000000.png"]
    ended = robot(roscore, "ros1_goal", "--server", "/object_detector/contour", *images, "--out", tmp_path / "found")
    assert ended.returncode == 0, ended.stderr
    found = json.loads((tmp_path / "found/result.json").read_text())["objects"]
    index = [one["name"] for one in found].index(CARTON_NAME)
    mask, truth = read_mask(tmp_path / f"found/mask_{index:06d}.png"), read_mask(dataset.scene / "mask_visib/000000_000000.png")
    assert (mask & truth).sum() / (mask | truth).sum() > 0.8

    asked = [*images, "--masks", tmp_path / f"found/mask_{index:06d}.png", "--class-names", CARTON_NAME]
    ended = robot(roscore, "ros1_goal", "--server", "/pose_estimator/render_compare", *asked, "--out", tmp_path / "posed")
    assert ended.returncode == 0, ended.stderr
    (posed,) = json.loads((tmp_path / "posed/result.json").read_text())["objects"]
    true = dataset.frames[0].instances[0].camera_from_model
    assert np.linalg.norm(np.array(posed["camera_from_model_mm"])[:3, 3] - true[:3, 3]) < 10


def test_the_robots_own_script_detects_and_poses_what_its_camera_sees(servers, roscore, dataset):
    command = [sys.executable, REPOSITORY / "tests/helpers/ros1_script.py", REPOSITORY / "ros/zeroshop/scripts/recognize"]
    words = ["_detector:=/object_detector/contour", "_estimator:=/pose_estimator/render_compare", f"_objects:={CARTON_NAME}"]
    environment = roscore | {"PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY / 'tests'}"}
    ended = subprocess.run([*command, *words], env=environment, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    (posed,) = json.loads(ended.stdout.splitlines()[-1])
    true = dataset.frames[0].instances[0].camera_from_model
    assert posed["name"] == CARTON_NAME and np.linalg.norm(1000 * np.array(posed["position_m"]) - true[:3, 3]) < 10
    words[0] = "_detector:=/object_detector/none"
    ended = subprocess.run([*command, *words], env=environment, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 1 and "there is no action server /object_detector/none" in ended.stderr


def test_bad_goals_are_answered_and_the_server_lives(servers, roscore, dataset, tmp_path):
    """The checks themselves are in test_goals.py; these goals go through ROS."""
    command = [sys.executable, REPOSITORY / "tests/helpers/ros1_bad_goals.py", dataset.scene]
    environment = roscore | {"PYTHONPATH": str(REPOSITORY / "tests")}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200)
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout.splitlines()[-1])
    reasons = {
        "no depth": "there is no depth image",
        "no colours": "the colour image is empty",
        "wrong encoding": "has the encoding '8UC2'",
        "short data": "has 10 bytes in rows of 960",
        "other size": "the depth image is 4 x 3 px",
        "all NaN": "no measured pixel",
        "empty mask": "mask 0 is empty",
        "unknown name": "there is no object 'teapot' here",
        "no names": "class_names is empty",
    }
    assert set(told) == {*reasons, "good"}
    for name, reason in reasons.items():
        assert told[name]["state"] == "aborted" and not told[name]["success"] and reason in told[name]["feedback"], told[name]
        assert told[name]["status"] == told[name]["feedback"]
    assert told["good"] == {"state": "succeeded", "success": True, "feedback": "", "status": ""}
    assert servers[0].poll() is None


def test_without_a_server_the_client_says_so(servers, roscore, dataset, tmp_path):
    ended = robot(
        roscore, "ros1_goal", "--server", "/pose_estimator/none", "--rgb", dataset.scene / "rgb/000000.png", "--out", tmp_path / "o"
    )
    assert ended.returncode == 1 and "there is no action server /pose_estimator/none" in ended.stderr
    assert not (tmp_path / "o").exists()


def test_without_a_roscore_everything_ends_with_the_remedy(roscore, dataset, tmp_path):
    elsewhere = roscore | {"ROS_MASTER_URI": "http://127.0.0.1:9"}
    ended = robot(elsewhere, "ros1_servers", "--models", dataset.folder / "models")
    assert ended.returncode == 1 and "no roscore answers at http://127.0.0.1:9; start one with: roscore" in ended.stderr
    assert "Traceback" not in ended.stderr
