"""Depth images as the source of the scale, good and bad ones."""

import re
import shutil

import cv2
import numpy as np
import pytest

from zeroshop_steps.geometry.cameras.registered_views import read_views
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.geometry.meshes.triangle_meshes import write_ply
from zeroshop_steps.geometry.rendering.mesh_rendering import MeshRenderer
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json

MM_A_UNIT = 2.5  # the true size of a unit of the registration


@pytest.fixture
def measure(carton, tmp_path, capsys):
    """Measure the carton by depth images, changed by `change(depth in mm, number)`; gives the record or the error."""
    views, _ = read_views(carton.cameras)
    renderer = MeshRenderer(carton.mesh)

    def run(change=lambda depth, number: depth, names=None, step_mm=1.0, kept=10, capture=None, emptied=False):
        folder = tmp_path / "depth"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for number, view in enumerate(views[:kept]):
            depth = renderer.cast_rays(view.camera).depth * MM_A_UNIT
            depth = np.where(depth > 0, depth, 900.0)  # a wall behind
            changed = change(depth, number)
            name = names[number] if names else view.camera.name
            write_image(folder / name, changed if changed.dtype == np.uint8 else np.rint(changed).astype(np.uint16))
        if emptied:
            (folder / views[0].camera.name).write_bytes(b"")
        write_ply(tmp_path / "clean.ply", carton.mesh)
        write_json(tmp_path / "capture" / "capture.json", capture or {})
        words = ["--method", "depth_camera", "--mesh", tmp_path / "clean.ply", "--cameras", carton.cameras, "--depth", folder]
        words += ["--capture", tmp_path / "capture", "--step-mm", step_mm, "--out", tmp_path / "height.json"]
        status = stage_main("zeroshop_steps.height", [str(word) for word in words])
        return read_json(tmp_path / "height.json") if status == 0 else capsys.readouterr().err

    return run


def test_aligned_depth_gives_the_scale(measure):
    record = measure()
    assert record["metres_per_unit"] == pytest.approx(MM_A_UNIT / 1000, rel=2e-3)
    assert record["height_m"] == pytest.approx(0.09 * MM_A_UNIT, rel=4e-3)
    assert record["scale_source"] == "depth_camera" and record["evidence"]["depth_images"] == 10
    assert record["metres_per_unit_deviation_share"] < 2e-3


def test_noise_holes_and_a_bad_image_do_little_harm(measure):
    rng = np.random.default_rng(0)

    def damage(depth, number):
        noisy = depth * (1.3 if number == 4 else 1.0) + rng.normal(0, 3.0, depth.shape)
        return np.where(rng.uniform(size=depth.shape) < 0.3, 0.0, np.clip(noisy, 0, None))

    assert measure(damage)["metres_per_unit"] == pytest.approx(MM_A_UNIT / 1000, rel=5e-3)


def test_other_steps_are_given_as_such(measure):
    assert measure(lambda depth, _: depth * 10, step_mm=0.1)["metres_per_unit"] == pytest.approx(MM_A_UNIT / 1000, rel=2e-3)


def test_photos_that_were_renamed_keep_their_depth(measure):
    names = [f"IMG_{number + 7}.png" for number in range(10)]
    record = measure(names=names, capture={"source_names": [name.replace(".png", ".jpg") for name in names]})
    assert record["evidence"]["depth_images"] == 10


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"change": lambda depth, _: depth / 1000}, "looks like metres"),
        ({"change": lambda depth, _: depth * 12}, "looks like millimetres, taken for metres"),
        ({"change": lambda depth, _: depth * 2, "capture": {"known_height_m": 0.09 * MM_A_UNIT}}, "by depth_camera .* by its known height"),
        ({"capture": {"source_frames": [0, 9]}}, "belong to photos"),
        ({"change": lambda depth, _: np.roll(depth, 40, axis=1)}, "not aligned with the photos"),
        ({"change": lambda depth, _: np.roll(depth, -40, axis=0)}, "not aligned with the photos"),
        ({"change": lambda depth, _: cv2.resize(depth, (160, 120))}, "160 x 120 px.*not aligned"),
        ({"change": lambda depth, _: (depth / 4).astype(np.uint8)}, "uint8.*expected a 16-bit PNG"),
        ({"change": lambda depth, _: depth * 0}, "have measured depth on the object"),
        ({"emptied": True}, "image .* cannot be read"),
        ({"kept": 2}, "depth images for 2 of the 10"),
        ({"step_mm": 0.0}, "a step of the depth images is 0 mm"),
    ],
)
def test_depth_images_that_are_no_good_are_refused(measure, how, message):
    error = measure(**how)
    assert isinstance(error, str) and re.search(message, error), error


def test_mast3r_says_what_it_lacks(carton, tmp_path, capsys):
    write_ply(tmp_path / "clean.ply", carton.mesh)
    write_json(tmp_path / "capture" / "capture.json", {})
    words = ["--method", "mast3r", "--mesh", tmp_path / "clean.ply", "--cameras", carton.cameras, "--capture", tmp_path / "capture"]
    assert stage_main("zeroshop_steps.height", [str(word) for word in [*words, "--out", tmp_path / "height.json"]]) == 1
    error = capsys.readouterr().err
    for part in ("the weights", "are not there", "MASt3R", "CC BY-NC-SA 4.0", "put that file at", "known and marker need no weights"):
        assert part in error
    assert not (tmp_path / "height.json").exists()
