"""Camera errors of a known disturbance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.camera_ring import ring_camera
from zeroshop_steps.evaluate.camera_error import compare_cameras, measure_object_errors_px
from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.cameras.pinhole import write_cameras
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json, write_json


@pytest.fixture(scope="module")
def truth():
    return tuple(ring_camera(index, 10, 400.0, (5.0, 35.0), (0.0, 0.0, 0.0), 600.0, (480, 360)) for index in range(10))


def in_another_frame(cameras):
    """The same cameras in a frame that is turned, moved and scaled."""
    turn = Rotation.from_euler("xyz", [20, -50, 130], degrees=True).as_matrix()
    result = []
    for camera in cameras:
        centre = 0.01 * turn @ camera.centre_in_world + [3.0, -2.0, 1.0]
        pose = np.eye(4)
        pose[:3, :3] = camera.camera_from_world[:3, :3] @ turn.T
        pose[:3, 3] = -pose[:3, :3] @ centre
        result.append(replace(camera, camera_from_world=pose))
    return tuple(result)


def test_frame_and_scale_do_not_count(truth):
    error = compare_cameras(in_another_frame(truth), truth)
    assert error.centre_mm.max() < 1e-6 and error.rotation_deg.max() < 1e-6 and error.focal_ratio == 1.0


def test_a_turned_camera_is_measured(truth):
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("x", 0.5, degrees=True).as_matrix()
    turned = (replace(truth[0], camera_from_world=turn @ truth[0].camera_from_world), *truth[1:])
    error = compare_cameras(in_another_frame(turned), truth)
    assert error.rotation_deg[0] == pytest.approx(0.5, abs=1e-6)
    assert error.rotation_deg[1:].max() < 1e-6 and error.centre_mm.max() < 1e-6


def test_a_moved_camera_is_measured(truth):
    moved = truth[0].camera_from_world.copy()
    moved[:3, 3] += [0.0, 0.0, 5.0]
    error = compare_cameras((replace(truth[0], camera_from_world=moved), *truth[1:]), truth)
    assert 3.5 < error.centre_mm[0] < 5.0  # the alignment takes a part
    assert error.centre_mm[1:].max() < 1.5


def test_two_cameras_cannot_be_aligned(truth):
    with pytest.raises(StepError, match="only 2 registered"):
        compare_cameras(truth[:2], truth)


def test_command_writes_json_and_table(truth, tmp_path):
    write_cameras(tmp_path / "truth", truth)
    write_cameras(tmp_path / "cameras" / "sparse", in_another_frame(truth))
    write_json(tmp_path / "cameras" / "registration.json", {"status": "ok", "reason": None})
    words = [
        "--method",
        "camera_error",
        "--cameras",
        tmp_path / "cameras",
        "--truth",
        tmp_path / "truth",
        "--out",
        tmp_path / "error.json",
    ]
    assert stage_main("zeroshop_steps.evaluate", [str(word) for word in words]) == 0
    record = read_json(tmp_path / "error.json")
    assert record["registered"] == record["images"] == 10 and record["mean_centre_error_mm"] < 1e-6
    lines = (tmp_path / "error.csv").read_text().splitlines()
    assert lines[0] == "camera,measure,value" and len(lines) == 1 + 7 + 20


def test_cameras_of_a_film_are_found_by_the_frames_taken_from_it(truth, tmp_path):
    """Image 0 of the capture is frame 6 of the film, and so on: the true cameras go by the film's numbers."""
    taken = [6, 0, 3, 9]
    write_cameras(tmp_path / "film" / "cameras", [replace(camera, name=f"{index:06d}.png") for index, camera in enumerate(truth)])
    write_json(tmp_path / "capture" / "capture.json", {"source_frames": taken})
    registered = [replace(truth[number], name=f"{index:06d}.png") for index, number in enumerate(taken)]
    write_cameras(tmp_path / "run" / "sparse", in_another_frame(registered))
    options = ["--truth", str(tmp_path / "film"), "--film-capture", str(tmp_path / "capture"), "--out", str(tmp_path / "error.json")]
    assert stage_main("zeroshop_steps.evaluate", ["--method", "camera_error", "--cameras", str(tmp_path / "run"), *options]) == 0
    error = read_json(tmp_path / "error.json")
    assert error["images"] == error["registered"] == 4 and error["max_centre_error_mm"] < 1e-6


def test_a_capture_of_photos_is_not_compared_with_a_film(truth, tmp_path, capsys):
    write_cameras(tmp_path / "film" / "cameras", list(truth))
    write_json(tmp_path / "capture" / "capture.json", {})
    options = ["--truth", str(tmp_path / "film"), "--film-capture", str(tmp_path / "capture"), "--out", str(tmp_path / "error.json")]
    assert stage_main("zeroshop_steps.evaluate", ["--method", "camera_error", "--cameras", str(tmp_path), *options]) == 1
    assert "names no source_frames" in capsys.readouterr().err


def test_an_object_lies_off_in_the_view_of_a_turned_camera(truth):
    """By focal length times angle, of which the alignment of all views takes a little."""
    sphere = ObjectSphere(np.zeros(3), 40.0)
    assert measure_object_errors_px(list(zip(truth, in_another_frame(truth), strict=True)), sphere).max() < 1e-3
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("y", 0.5, degrees=True).as_matrix()
    turned = (replace(truth[0], camera_from_world=turn @ truth[0].camera_from_world), *truth[1:])
    errors = measure_object_errors_px(list(zip(turned, truth, strict=True)), sphere)
    assert errors[0] == pytest.approx(600.0 * np.radians(0.5), rel=0.3) and errors[1:].max() < 0.3 * errors[0]
