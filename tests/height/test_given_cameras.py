"""The metres of given cameras as the scale."""

import numpy as np
import pytest

from helpers.given import given_cameras
from zeroshop_steps.capture.cameras_json import GivenCamera, GivenCameras
from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.height.record import Scale, compare_with_depth
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json


@pytest.fixture
def measure(carton, tmp_path, capsys):
    """Measure the carton by cameras in metres, of which a unit of the registration is a millimetre; gives the record or the error."""
    cameras = [view.camera for view in read_views(carton.cameras)[0]]

    def run(change=lambda given: given, noise_m=0.0, height_m=None, written=True):
        write_ply(tmp_path / "clean.ply", carton.mesh)
        write_json(tmp_path / "capture/capture.json", {})
        if written:
            change(given_cameras(cameras, noise_m)).write(tmp_path / "capture/cameras.json")
        words = ["--method", "given_cameras", "--mesh", tmp_path / "clean.ply", "--cameras", carton.cameras]
        words += ["--capture", tmp_path / "capture", "--out", tmp_path / "height.json", *(["--height-m", height_m] if height_m else [])]
        status = stage_main("zeroshop_steps.height", [str(word) for word in words])
        return read_json(tmp_path / "height.json") if status == 0 else capsys.readouterr().err

    return run


def moved(given: GivenCameras, names, by_m: float) -> GivenCameras:
    images = dict(given.images)
    for name in names:
        pose = images[name].camera_from_world.copy()
        pose[0, 3] += by_m
        images[name] = GivenCamera(images[name].lens, pose)
    return GivenCameras(images, given.source, given.metric)


def test_exact_cameras_give_the_exact_scale(measure):
    record = measure()
    assert record["metres_per_unit"] == pytest.approx(1e-3, rel=1e-6) and record["scale_source"] == "given_cameras"
    assert record["metres_per_unit_deviation_share"] < 1e-6


def test_the_deviation_is_that_of_noisy_cameras(measure):
    """The error of many draws is as large as what is said of them."""
    errors, said = [], []
    for seed in range(12):
        record = measure(lambda given, seed=seed: _noisy(given, 0.003, seed))
        errors.append(record["metres_per_unit"] / 1e-3 - 1)
        said.append(record["metres_per_unit_deviation_share"])
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) / np.mean(said) < 2


def _noisy(given: GivenCameras, noise_m: float, seed: int) -> GivenCameras:
    rng, images = np.random.default_rng(seed), {}
    for name, one in given.images.items():
        pose = one.camera_from_world.copy()
        pose[:3, 3] += rng.normal(0, noise_m, 3)
        images[name] = GivenCamera(one.lens, pose)
    return GivenCameras(images, given.source)


def test_one_camera_that_is_far_off_does_no_harm(measure):
    record = measure(lambda given: moved(given, [next(iter(given.images))], 0.2))
    assert record["metres_per_unit"] == pytest.approx(1e-3, rel=1e-3) and record["evidence"]["left_out"] == 1


def test_cameras_without_a_unit_leave_the_scale_unknown(measure):
    assert measure(lambda given: GivenCameras(given.images, given.source, metric=False))["scale"] == "unknown"


def test_other_cameras_or_none_are_refused(measure):
    def turn_round(given):
        names = list(given.images)
        order = np.random.default_rng(0).permutation(names)
        return GivenCameras({name: given.images[other] for name, other in zip(names, order, strict=True)}, given.source)

    assert "belong to another recording" in measure(turn_round)
    assert "2 registered cameras have a given pose" in measure(lambda given: GivenCameras(dict(list(given.images.items())[:2]), "x"))


def test_a_capture_without_cameras_is_refused(measure):
    assert "no cameras came with this capture" in measure(written=False)


def test_a_height_in_another_unit_contradicts(measure):
    assert "another unit than metres" in measure(height_m=0.9)


def test_depth_in_another_unit_than_the_cameras_is_told(tmp_path):
    scale, stereo = Scale("given_cameras", 1.0, 0.001, {}), tmp_path / "seeds.npz"
    assert compare_with_depth(scale, stereo) is None
    for mm_per_unit, said in ((1000.0, None), (1010.0, None), (10_000.0, "10 times as large as by given_cameras"), (100.0, "0.1 times")):
        write_json(tmp_path / "stereo.json", {"given_depth": {"mm_per_unit": mm_per_unit}})
        line = compare_with_depth(scale, stereo)
        assert (line is None) == (said is None) and (said or "") in (line or "")
