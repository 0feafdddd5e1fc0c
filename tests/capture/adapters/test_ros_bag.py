"""Bags of ROS 1 and ROS 2, recorded by the tests' own robot, come in with the frames, poses, lenses and depth that they hold."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.given import small_ring
from helpers.recorded_bag import COLOR, record
from zeroshop_steps.app.importing import find_source, import_capture
from zeroshop_steps.capture.adapters import recognize
from zeroshop_steps.capture.adapters.form import ImportOptions
from zeroshop_steps.capture.cameras_json import Lens, read_given_cameras
from zeroshop_steps.capture.upright import turn_lens, turn_pose
from zeroshop_steps.geometry.imaging.images import decode_image, list_images, read_image
from zeroshop_steps.runtime.errors import StepError

pytest.importorskip("rosbags", reason="bags need the extra robot")


def in_metres(camera):
    pose = camera.camera_from_world.copy()
    pose[:3, 3] /= 1000
    return replace(camera, camera_from_world=pose)


CAMERAS = [in_metres(camera) for camera in small_ring(10)]
RNG = np.random.default_rng(0)
PICTURES = {camera.name: RNG.integers(0, 255, (120, 160, 3), np.uint8) for camera in CAMERAS}
DEPTHS_MM = {camera.name: np.full((120, 160), 400 + number) for number, camera in enumerate(CAMERAS)}
NAMES = {1: "arm.bag", 2: "arm"}


def test_a_bag_is_recognized_by_what_it_holds(tmp_path):
    record(tmp_path / "arm", 2, CAMERAS[:2], PICTURES)
    record(tmp_path / "arm.bag", 1, CAMERAS[:2], PICTURES)
    (file,) = (tmp_path / "arm").glob("*.mcap")
    for path in (tmp_path / "arm", tmp_path / "arm.bag", file):
        assert recognize(path).title == "a bag of ROS"
    (tmp_path / "other").mkdir()
    (tmp_path / "other/metadata.yaml").touch()
    (tmp_path / "film.mp4").touch()
    assert recognize(tmp_path / "other") is None and recognize(tmp_path / "film.mp4") is None


@pytest.mark.parametrize("ros", [1, 2])
def test_frames_come_with_their_cameras_and_depth(ros, tmp_path):
    record(tmp_path / NAMES[ros], ros, CAMERAS, PICTURES, DEPTHS_MM, distortion=(0.1, -0.05, 0.001, 0.002, 0.0))
    import_capture(tmp_path / NAMES[ros], tmp_path / "ours", ImportOptions())
    given = read_given_cameras(tmp_path / "ours/cameras.json")
    images = list_images(tmp_path / "ours/images")
    assert given.metric and len(images) == len(CAMERAS) and given.source == f"10 images on {COLOR}/image_raw of the bag {NAMES[ros]}"
    for camera, path in zip(CAMERAS, images, strict=True):
        assert np.array_equal(read_image(path), PICTURES[camera.name])
        one = given.images[path.name]
        np.testing.assert_allclose(one.camera_from_world, camera.camera_from_world, atol=1e-9)
        expected = (*camera.pinhole_params, 0.1, -0.05, 0.001, 0.002)
        assert one.lens.model == "OPENCV" and one.lens.params == pytest.approx(expected)
        depth_mm = decode_image(tmp_path / f"ours/depth/{path.stem}.png", -1) * given.depth_step_mm
        assert np.allclose(depth_mm, DEPTHS_MM[camera.name], atol=0.1)


@pytest.mark.parametrize("turns", [1, 2])
def test_images_of_a_camera_that_is_mounted_turned_become_upright(turns, tmp_path):
    def mount(camera):
        height, width = PICTURES[camera.name].shape[:2]
        lens = Lens("PINHOLE", width, height, tuple(camera.pinhole_params))
        back = turn_lens(lens, -turns % 4)
        pose = turn_pose(np.linalg.inv(camera.camera_from_world), -turns % 4)
        return replace(
            camera, width_px=back.width_px, height_px=back.height_px,
            intrinsics=np.array(back.to_colmap().calibration_matrix()), camera_from_world=np.linalg.inv(pose),
        )  # fmt: skip

    back = {name: np.rot90(image, -turns) for name, image in PICTURES.items()}
    depth = {name: np.rot90(image, -turns) for name, image in DEPTHS_MM.items()}
    record(tmp_path / NAMES[2], 2, [mount(camera) for camera in CAMERAS], back, depth)
    import_capture(tmp_path / NAMES[2], tmp_path / "ours", ImportOptions())
    given = read_given_cameras(tmp_path / "ours/cameras.json")
    for camera, path in zip(CAMERAS, list_images(tmp_path / "ours/images"), strict=True):
        assert np.array_equal(read_image(path), PICTURES[camera.name])
        np.testing.assert_allclose(given.images[path.name].camera_from_world, camera.camera_from_world, atol=1e-9)
        assert given.images[path.name].lens.params == pytest.approx(camera.pinhole_params)
        depth_mm = decode_image(tmp_path / f"ours/depth/{path.stem}.png", -1) * given.depth_step_mm
        assert np.allclose(depth_mm, DEPTHS_MM[camera.name], atol=0.1)


def test_the_sharpest_of_many_frames_are_taken(tmp_path):
    """A camera that rests at ten views, with one sharp frame of each."""
    cameras = [replace(CAMERAS[number // 4], name=f"{number:03d}.png") for number in range(40)]
    sharp = {camera.name: PICTURES[CAMERAS[number // 4].name] for number, camera in enumerate(cameras)}
    pictures = {name: image if number % 4 == 1 else image // 3 + 80 for number, (name, image) in enumerate(sharp.items())}
    record(tmp_path / "arm", 2, cameras, pictures)
    import_capture(tmp_path / "arm", tmp_path / "ours", ImportOptions())
    taken = [read_image(path) for path in list_images(tmp_path / "ours/images")]
    sharp_ones = [camera.name for camera in CAMERAS if any(np.array_equal(image, PICTURES[camera.name]) for image in taken)]
    assert len(sharp_ones) >= 9 and len(taken) < len(cameras)


@pytest.mark.parametrize(
    ("distortion", "model", "lens"),
    [
        ((), "", "PINHOLE"),
        ((0.1, 0.05, 0.0, 0.0), "equidistant", "OPENCV_FISHEYE"),
        ((0.1, 0.0, 0.0, 0.0, 0.02), "plumb_bob", "FULL_OPENCV"),
        ((0.1, 0.0, 0.0, 0.0, 0.02, 0.3, 0.0, 0.01), "rational_polynomial", "FULL_OPENCV"),
    ],
)
def test_distortion_becomes_colmaps_lens(distortion, model, lens, tmp_path):
    record(tmp_path / "arm", 2, CAMERAS[:3], PICTURES, distortion=distortion, model=model)
    import_capture(tmp_path / "arm", tmp_path / "ours", ImportOptions())
    (found, *_) = read_given_cameras(tmp_path / "ours/cameras.json").images.values()
    # Pixels project as OpenCV does it.
    import cv2

    points = np.array([[0.1, -0.05, 0.4], [-0.1, 0.08, 0.5]])
    matrix = CAMERAS[0].intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    if model == "equidistant":
        expected = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0]
    else:
        expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(distortion or (0.0,) * 4))[0]
    projected = found.lens.to_colmap().img_from_cam(points)
    assert found.lens.model == lens
    np.testing.assert_allclose(projected, expected[:, 0] + 0.5, atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"info": False}, "no colour images with a sensor_msgs/CameraInfo on camera_info beside them; colour images: /camera/color"),
        ({"tf_late_ns": 7_200 * 10**9}, "two clocks"),
        ({"tf_late_ns": 400_000_000}, "at the times of 1 of 3 images: two clocks"),
        ({"tf_nan": True}, "3 of 3 poses hold NaN"),
        ({"distortion": (0.1, 0, 0, 0, 0, 0, 0, 0, 0.2, 0, 0, 0), "model": "rational_polynomial"}, "which COLMAP's lenses lack"),
    ],
)
def test_a_bag_that_cannot_be_used_is_refused_in_words(changes, said, tmp_path):
    record(tmp_path / "arm", 2, CAMERAS[:3], PICTURES, **changes)
    with pytest.raises(StepError, match=said):
        import_capture(tmp_path / "arm", tmp_path / "ours", ImportOptions())
    assert not (tmp_path / "ours").exists()


def test_a_damaged_bag_and_an_unknown_topic_are_named(tmp_path):
    (tmp_path / "arm.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(StepError, match=r"arm\.bag cannot be read"):
        import_capture(tmp_path / "arm.bag", tmp_path / "ours", ImportOptions())
    record(tmp_path / "arm", 2, CAMERAS[:3], PICTURES)
    with pytest.raises(StepError, match=r"no colour images on /left; it has /camera/color/image_raw \(3 images\)"):
        import_capture(tmp_path / "arm", tmp_path / "ours", ImportOptions(topic="/left"))


def test_depth_of_another_camera_is_left_out_and_said(tmp_path, capsys):
    record(tmp_path / "arm", 2, CAMERAS[:3], PICTURES, DEPTHS_MM, depth_frame="camera_depth_optical_frame")
    source = find_source(tmp_path / "arm", tmp_path, "arm")
    said = capsys.readouterr().err
    assert not source.depth and source.poses and "record depth that is aligned to colour" in said


def test_colour_is_taken_rather_than_larger_infrared(tmp_path):
    record(tmp_path / "arm", 2, CAMERAS[:3], PICTURES, infrared=True)
    import_capture(tmp_path / "arm", tmp_path / "ours", ImportOptions())
    assert np.array_equal(read_image(list_images(tmp_path / "ours/images")[0]), PICTURES[CAMERAS[0].name])
    import_capture(tmp_path / "arm", tmp_path / "theirs", ImportOptions(topic="/camera/infra1/image_raw"))
    (found, *_) = read_given_cameras(tmp_path / "theirs/cameras.json").images.values()
    assert (found.lens.width_px, found.lens.height_px) == (320, 240)


def test_a_camera_that_tf_does_not_move_is_estimated(tmp_path, capsys):
    still = [replace(camera, camera_from_world=CAMERAS[0].camera_from_world) for camera in CAMERAS]
    record(tmp_path / "arm.bag", 1, still, PICTURES)
    source = find_source(tmp_path / "arm.bag", tmp_path, "arm")
    assert not source.poses and "does not move in tf" in capsys.readouterr().err


def test_clocks_that_differ_a_little_are_told(tmp_path, capsys):
    """Of tf, whose last second is missing, and of the depth camera, whose images then belong to no picture."""
    record(tmp_path / "arm", 2, CAMERAS, PICTURES, DEPTHS_MM, tf_late_ns=-400_000_000, depth_late_ns=60_000_000)
    import_capture(tmp_path / "arm", tmp_path / "ours", ImportOptions())
    said = capsys.readouterr().err
    assert "tf knows the camera at the times of 8 of 10 images" in said and "only 0 of 10 images have depth" in said
    assert len(read_given_cameras(tmp_path / "ours/cameras.json").poses) == 8 and not (tmp_path / "ours/depth").exists()
