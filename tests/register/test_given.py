"""Registration by cameras that come with the capture."""

import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.given import given_cameras
from zeroshop_steps.capture.cameras_json import GivenCamera, GivenCameras
from zeroshop_steps.evaluate.camera_error import compare_cameras
from zeroshop_steps.geometry.cameras.pinhole import align_to_truth, pair_with_truth, read_sparse_model
from zeroshop_steps.geometry.cameras.transforms import OPENCV_FROM_OPENGL, compute_scale
from zeroshop_steps.register.colmap import ColmapOptions
from zeroshop_steps.register.features.sift import SiftOptions
from zeroshop_steps.register.given.solve import register
from zeroshop_steps.register.scene.image_set import read_image_set
from zeroshop_steps.register.scene.record import Inconsistent
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

OPTIONS = ColmapOptions(SiftOptions(max_features=1500))


def changed(given: GivenCameras, change) -> GivenCameras:
    return GivenCameras(
        {name: GivenCamera(one.lens, change(name, one.camera_from_world)) for name, one in given.images.items()}, given.source, given.metric
    )


@pytest.fixture(scope="module")
def truth(carton_capture):
    return read_sparse_model(carton_capture / "truth").cameras


@pytest.mark.slow
def test_noisy_cameras_come_right_and_their_metres_stay(carton_capture, truth, tmp_path):
    """An arm's noise, two images without a pose, and one whose pose is wrong by 0.1 m and 30 degrees."""
    given = given_cameras(truth, 0.001, 0.3)
    lost = dict(given.images)
    for name in ("000003.png", "000008.png"):
        lost[name] = GivenCamera(lost[name].lens, None)
    wrong = lost["000005.png"].camera_from_world.copy()
    wrong[:3, :3] = Rotation.from_rotvec([0.0, np.radians(30), 0.0]).as_matrix() @ wrong[:3, :3]
    wrong[0, 3] += 0.1
    lost["000005.png"] = GivenCamera(lost["000005.png"].lens, wrong)
    given = GivenCameras(lost, given.source, True, 0.001, 0.3)
    given.write(tmp_path / "capture/cameras.json")
    for part in ("images", "masks"):
        shutil.copytree(carton_capture / part, tmp_path / "capture" / part)
    words = [
        "--method",
        "given",
        "--capture",
        tmp_path / "capture",
        "--scene",
        "su_h",
        "--out",
        tmp_path / "cameras",
        "--max-features",
        1500,
    ]
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 0
    cameras = read_sparse_model(tmp_path / "cameras/sparse").cameras
    error = compare_cameras(cameras, truth)
    assert len(cameras) == 10 and error.centre_mm.mean() < 0.3 and error.rotation_deg.max() < 0.1
    assert compute_scale(align_to_truth(pair_with_truth(cameras, truth))) == pytest.approx(1000, rel=4e-3)
    record = read_json(tmp_path / "cameras/registration.json")
    assert record["lens"]["params"] == pytest.approx(given.images["000000.png"].lens.params)  # placing images anew leaves lenses alone
    assert record["method"] == "given" and record["given"]["known"] == 8 and record["left_out"] == []
    shifts_mm = record["given"]["shift_mm"]
    assert shifts_mm.pop("000005.png") > 50 and max(shifts_mm.values()) < 5
    assert any("000005.png" in line or "noisier than stated" in line for line in record["warnings"])


@pytest.mark.slow
def test_poses_with_other_axes_are_refused_with_the_remedy(carton_capture, truth, tmp_path):
    given = changed(given_cameras(truth), lambda name, pose: OPENCV_FROM_OPENGL @ pose)
    with pytest.raises(Inconsistent, match="a robot's arm.*OpenGL's axes"):
        register(read_image_set(carton_capture), given, tmp_path / "cameras", OPTIONS)


def test_millimetres_are_refused_before_anything_is_matched(carton_capture, truth, tmp_path):
    def enlarge(name, pose):
        return np.block([[pose[:3, :3], 1000 * pose[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]])

    with pytest.raises(Inconsistent, match="seem to be in millimetres"):
        register(read_image_set(carton_capture), changed(given_cameras(truth), enlarge), tmp_path / "cameras", OPTIONS)


def test_too_few_poses_and_a_capture_without_cameras_are_refused(carton_capture, truth, tmp_path, capsys):
    few = changed(given_cameras(truth), lambda name, pose: pose if name < "000002" else None)
    with pytest.raises(StepError, match="2 of 10 images have a given pose"):
        register(read_image_set(carton_capture), few, tmp_path / "cameras", OPTIONS)
    words = ["--method", "given", "--capture", carton_capture, "--scene", "su_h", "--out", tmp_path / "cameras"]
    assert stage_main("zeroshop_steps.register", [str(word) for word in words]) == 1
    assert "no cameras came with this capture" in capsys.readouterr().err
