"""The scan's node, without ROS."""

from pathlib import Path

import numpy as np
import pytest

from helpers.scan_messages import HEIGHT, WIDTH, arguments, depth, image, photo, show, stand, transforms, view
from zeroshop_steps.capture.adapters.tf_tree import TransformTree
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.robot import scan_node
from zeroshop_steps.robot.scan_node import ScanNode, make_node
from zeroshop_steps.runtime.errors import StepError


def test_views_are_recorded_with_the_pose_of_their_time(node: ScanNode, tmp_path: Path) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    reply = node.record()
    assert reply.success and "recorded 0001.png" in reply.message, reply.message
    given = read_given_cameras(tmp_path / "scan/cameras.json")
    np.testing.assert_allclose(given.poses["0001.png"], np.linalg.inv(view(180)), atol=1e-6)
    one = given.images["0001.png"]
    assert one.lens.params == (150.0, 150.0, 80.0, 60.0) and given.position_deviation_m == 0.001 and given.depth_step_mm == 0.1
    assert given.source == "tf of base"


def test_views_are_proposed_one_after_the_other(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    first = node.next_view()
    assert first.success and first.base_from_camera is not None and "no view yet" in first.message
    node.record()
    far, other = node.next_view(), node.next_view()
    assert far.base_from_camera is not None and other.base_from_camera is not None
    assert np.linalg.norm(far.base_from_camera[:3, 3] - other.base_from_camera[:3, 3]) > 0.03
    assert far.base_from_camera[0, 3] > 0.6  # the side that was not seen


def test_it_says_when_it_is_enough(node: ScanNode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zeroshop_steps.scan.next_views.ENOUGH_SHARE", 1e9)
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    assert node.record().success
    reply = node.next_view()
    assert reply.success and reply.message.startswith("enough: 1 views") and reply.base_from_camera is None


def test_an_arm_that_moves_is_refused(node: ScanNode) -> None:
    for step in range(25):
        stand(node, view(150 + step), 9.0 + 0.05 * step, 9.0 + 0.05 * step)
    show(node, 10.1)
    reply = node.record()
    assert not reply.success and "not at rest" in reply.message


def lack_image(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)


def lack_info(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    node._info = None


def lack_depth(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    node.take_image(photo(10.0))
    node.take_depth(depth(9.5))


def other_depth(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    node.take_image(photo(10.0))
    node.take_depth(depth(10.0, "camera_depth_optical_frame"))


def other_clock(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 99.0)


def other_frame(node: ScanNode) -> None:
    node.take_image(image(np.zeros((HEIGHT, WIDTH, 3), np.uint8), "rgb8", 10.0, "elsewhere"))
    node.take_depth(depth(10.0, "elsewhere"))


def other_base(node: ScanNode) -> None:
    node.base_frame = "world"
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)


def other_size(node: ScanNode) -> None:
    stand(node, view(180), 9.0, 10.2)
    node.take_image(image(np.zeros((60, 80, 3), np.uint8), "rgb8", 10.0))
    node.take_depth(depth(10.0))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lack_image, "no image has come on /camera/color/image_raw"),
        (lack_info, "no camera message has come on /camera/color/camera_info"),
        (lack_depth, "no depth on .* within 20 ms"),
        (other_depth, "of the frame 'camera_depth_optical_frame'.*aligned"),
        (other_clock, r"at the image's time, 99\.00 s.*from 9\.00 to 10\.20 s.*clocks"),
        (other_frame, "tf does not know the camera's frame 'elsewhere'"),
        (other_base, "tf does not know the base frame 'world'"),
        (other_size, "about images of 160 x 120 px"),
    ],
)
def test_what_is_missing_is_told(node: ScanNode, tmp_path: Path, spoil, message: str) -> None:
    spoil(node)
    reply = node.record()
    assert not reply.success
    with pytest.raises(StepError, match=message):
        raise StepError(reply.message)
    assert not (tmp_path / "scan").exists()


def test_an_old_image_is_not_recorded(node: ScanNode, monkeypatch: pytest.MonkeyPatch) -> None:
    stand(node, view(180), 9.0, 10.2)
    show(node, 10.0)
    monkeypatch.setattr(scan_node, "STALE_S", -1.0)
    assert "does the camera still run" in node.record().message


def test_options_that_contradict_are_told(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="either --depth-topic, or --without-depth"):
        make_node(arguments(tmp_path, depth_topic=None))


def test_tf_does_not_grow_without_end() -> None:
    tree = TransformTree()
    for time_s in range(100):
        tree.add(transforms("a", "b", np.eye(4), float(time_s)), False)
        tree.add(transforms("b", "c", np.eye(4), 0.0), True)
    tree.forget_before(90_000_000_000)
    assert len(tree.find_chain("c")[1].times_ns) == 10 and tree.look_up("c", 95_000_000_000) is not None
    tree.forget_before(10**15)
    assert tree.find_chain("b")[0].times_ns == [99_000_000_000]
