"""The arm in MuJoCo: it goes where it is sent within its limits, feels what it touches; and scans a model into a capture."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.coarse_ground import coarse_ground
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.geometry.imaging.images import list_images, read_depth_mm, read_image
from zeroshop_steps.geometry.meshes.ply_surface import read_ply
from zeroshop_steps.grasp.gripper import GRIPPERS
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan.arm.arm_reach import ArmReach
from zeroshop_steps.scan.arm.kinematics import ARMS, JOINTS
from zeroshop_steps.scan.reach import Move
from zeroshop_steps.scan.workspace import Box
from zeroshop_steps.synthetic.demo_objects import write_demo_object

pytest.importorskip("mujoco", reason="needs zeroshop[robot]")
from zeroshop_steps.simulate.arm.arm_world import ArmWorld, flange_from_gripper, hand_with_camera  # noqa: E402
from zeroshop_steps.simulate.arm.scan_robot import ScanRobot  # noqa: E402
from zeroshop_steps.simulate.arm.scan_scene import ScanScene  # noqa: E402
from zeroshop_steps.simulate.arm_scan import TrueSurface  # noqa: E402

HSR = GRIPPERS["hsr"]
UR10E = ARMS["ur10e"]
BOX = Box.around(np.array([0.6, 0.0, 0.1]), np.array([0.12, 0.12, 0.2]))
CORNERS = np.array([[x, y, z] for x in (0.56, 0.64) for y in (-0.04, 0.04) for z in (0.001, 0.18)])


@pytest.fixture(scope="module", autouse=True)
def table() -> Iterator[None]:
    """The table is as fine as photos of 320 pixels show."""
    with coarse_ground(1024):
        yield


@pytest.fixture(scope="module")
def bottle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bottle")
    write_demo_object("mustard_bottle", folder)
    return folder / "model.ply"


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("gripper", GRIPPERS)
def test_links_are_where_the_kinematics_say(name: str, gripper: str) -> None:
    joints = np.array([0.4, -1.2, 1.1, -0.7, -1.3, 0.6])
    hand = hand_with_camera(GRIPPERS[gripper])
    world = ArmWorld(ARMS[name], hand, GRIPPERS[gripper], None, joints)
    np.testing.assert_allclose(world.joints_rad, joints)
    np.testing.assert_allclose(world.camera_pose(), ARMS[name].find_flange(joints) @ hand.flange_from_camera, atol=1e-9)


def test_the_arm_reaches_views_and_stands_still() -> None:
    hand = hand_with_camera(HSR)
    world = ArmWorld(UR10E, hand, HSR, CORNERS)
    reach = ArmReach(UR10E, hand, np.eye(4), 0.0, BOX, world.joints_rad)
    reached = 0
    for azimuth, elevation in ((180, 30), (90, 20), (0, 45), (-60, 70)):
        direction = direction_at(np.radians(azimuth), np.radians(elevation))
        (move,) = reach.plan(np.linalg.inv(look_at(BOX.centre_m + 0.35 * direction, BOX.centre_m))[None])
        if move is None:
            continue
        assert world.follow(move.waypoints_rad) < 1e-4 and not world.touched
        np.testing.assert_allclose(world.camera_pose(), move.world_from_camera, atol=2e-4)
        before = world.camera_pose()
        world.follow([])
        assert np.abs(world.camera_pose() - before).max() < 1e-5
        reach.joints_rad = world.joints_rad
        reached += 1
    assert reached >= 3


def test_a_joint_stops_at_its_limit() -> None:
    world = ArmWorld(UR10E, hand_with_camera(HSR), HSR)
    beyond = np.array(UR10E.home_rad)
    beyond[3] = -6.8
    world.follow([beyond])
    assert world.joints_rad[3] > UR10E.low_rad[3] - 0.05


def test_what_is_in_the_way_is_touched(bottle: Path) -> None:
    scene = ScanScene(read_ply(bottle), bottle, 0.6)
    robot = ScanRobot(UR10E, HSR, scene, 160, 120)
    free = ArmReach(UR10E, robot.reach.hand, np.eye(4), -1.0, None, robot.world.joints_rad)
    # The camera looks down from where the bottle is: without a box to keep out of, the planner goes through it.
    (move,) = free.plan(np.linalg.inv(look_at(np.array([0.6, 0.001, 0.14]), np.array([0.6, 0.0, 0.0])))[None])
    assert move is not None
    try:
        assert robot.go(move).touched
    except StepError as error:
        assert "blocked" in str(error)
        assert robot.world.touched


def test_a_goal_that_is_not_reached_is_told(bottle: Path) -> None:
    robot = ScanRobot(UR10E, HSR, ScanScene(read_ply(bottle), bottle, 0.6), 160, 120)
    through_the_table = np.array(UR10E.home_rad)
    through_the_table[1] = 0.4
    with pytest.raises(StepError, match="blocked"):
        robot.go(Move(np.eye(4), 0.0, (through_the_table,)))


def test_fingers_are_not_in_the_picture() -> None:
    for gripper in GRIPPERS.values():
        hand, tip = hand_with_camera(gripper), flange_from_gripper(gripper)
        boxes = gripper.boxes(np.zeros(1))[0]
        corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for box in boxes for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        seen = (np.linalg.inv(hand.flange_from_camera) @ tip @ np.column_stack([corners, np.ones(len(corners))]).T)[:3]
        ahead = seen[2] > 0.001
        assert (np.abs(seen[1, ahead] / seen[2, ahead]) > 0.5 * 0.75 / 0.96).all()  # half the image's height, in focal lengths


def test_the_true_surface_counts_what_is_within_reach(bottle: Path) -> None:
    scene = ScanScene(read_ply(bottle), bottle, 0.6)
    robot = ScanRobot(UR10E, HSR, scene, 320, 240)
    views = robot.reachable_views()
    true = TrueSurface(scene, map(robot.sphere.camera_at, views))
    assert 0.85 < true.measurable.mean() < 0.98  # the underside is never seen
    camera = robot.sphere.camera_at(views[0])
    depth_m = scene.depth_m(camera, np.random.default_rng(0))
    one = true.measured(camera, depth_m)
    assert 0.1 < true.share(one) < 0.7
    assert true.share(true.measured(camera, depth_m + np.float32(0.01))) < 0.1
    assert (one & true.sees(camera)).sum() > 0.8 * true.sees(camera).sum()


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["next_best", "two_rings"])
def test_a_scan_is_a_capture_with_known_cameras(bottle: Path, tmp_path: Path, policy: str) -> None:
    words = ["--method", "arm_scan", "--model", str(bottle), "--policy", policy, "--views", "4", "--width", "320", "--height", "240"]
    assert stage_main("zeroshop_steps.simulate", [*words, "--out", str(tmp_path / "scan")]) == 0
    given = read_given_cameras(tmp_path / "scan/cameras.json")
    images = list_images(tmp_path / "scan/images")
    assert len(images) == len(given.poses) == 4 and given.depth_step_mm == 0.1 and given.position_deviation_m == 0.0005
    record = json.loads((tmp_path / "scan/scan.json").read_text())
    shares = [row["completeness"] for row in record["views"]]
    assert shares == sorted(shares) and shares[-1] > 0.6 and not any(row["touched"] for row in record["views"])
    for path in images:
        # Upright, and depth where the object is: its middle is seen in the middle of the image.
        pose = given.poses[path.name]
        assert pose[1, 2] < 0.2 and read_image(path).std() > 10
        middle = pose @ np.array([0.6, 0.0, 0.09, 1.0])
        assert abs(np.median(read_depth_mm(tmp_path / "scan/depth" / path.name)[100:140, 140:180]) / 1000 - middle[2]) < 0.08
    # It is continued where it was left, by proposals alone.
    words[words.index("--views") + 1] = "5"
    status = stage_main("zeroshop_steps.simulate", [*words, "--out", str(tmp_path / "scan")])
    assert (status, len(list_images(tmp_path / "scan/images"))) == ((0, 5) if policy == "next_best" else (1, 4))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--views", "0"], "--views is 0"),
        (["--width", "10"], "image size 10 x 750"),
        (["--distance-m", "600"], "--distance-m is 600"),
        (["--seed", "-1"], "must not be negative"),
        (["--least-views", "99"], "--least-views is 99"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str) -> None:
    command = ["--method", "arm_scan", "--model", "model.ply", "--out", str(tmp_path / "scan"), *words]
    assert stage_main("zeroshop_steps.simulate", command) == 1
    assert message in capsys.readouterr().err and not (tmp_path / "scan").exists()


def test_an_arm_has_six_joints() -> None:
    for arm in ARMS.values():
        assert len(arm.a_m) == len(arm.home_rad) == JOINTS and arm.within_limits(np.array([arm.home_rad]))[0]
