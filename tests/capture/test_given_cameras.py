"""cameras.json: read as it was written, and its faults named."""

import json

import numpy as np
import pytest

from helpers.given import given_cameras, small_ring
from zeroshop_steps.capture.cameras_json import Lens, read_given_cameras
from zeroshop_steps.capture.photos import import_photos
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json


@pytest.fixture
def written(tmp_path):
    """cameras.json after `change(content)`; gives its path."""
    given = given_cameras(small_ring(), 0.001, 0.3)

    def write(change=lambda content: None):
        given.write(tmp_path / "cameras.json")
        content = json.loads((tmp_path / "cameras.json").read_text())
        change(content)
        (tmp_path / "cameras.json").write_text(json.dumps(content))
        return tmp_path / "cameras.json"

    return write


def of_first(change):
    return lambda content: change(content["images"]["000000.png"])


def test_what_is_written_is_read(written):
    given, there = given_cameras(small_ring(), 0.001, 0.3), read_given_cameras(written())
    assert there.position_deviation_m == 0.001 and there.rotation_deviation_deg == 0.3 and there.metric
    for name, one in given.images.items():
        assert there.images[name].lens == one.lens
        assert np.allclose(there.images[name].camera_from_world, one.camera_from_world, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda one: one["camera_from_world"][0].__setitem__(slice(0, 3), [-v for v in one["camera_from_world"][0][:3]]), "left-handed"),
        (lambda one: one.update(camera_from_world=[[2 * v for v in row] for row in one["camera_from_world"]]), "scales by 2"),
        (lambda one: one.update(camera_from_world=[[1, 2], [3, 4]]), "4 rows of 4 numbers"),
        (lambda one: one.pop("lens"), "has no lens"),
        (lambda one: one["lens"].update(model="FOO"), "lens cannot be read"),
        (lambda one: one["lens"].update(params=[500.0]), "does not take the params"),
    ],
)
def test_a_bad_image_is_named_with_its_fault(written, change, said):
    with pytest.raises(StepError, match=f"000000.png.*{said}"):
        read_given_cameras(written(of_first(change)))


def test_a_few_poses_without_numbers_are_unknown_and_half_of_them_refused(written):
    def lose(count):
        def change(content):
            for name in sorted(content["images"])[:count]:
                content["images"][name]["camera_from_world"][1][3] = float("nan")

        return change

    given = read_given_cameras(written(lose(2)))
    assert len(given.poses) == 10 and "2 of 12" in given.warnings[0]
    with pytest.raises(StepError, match="6 of 12 poses hold NaN.*lost track"):
        read_given_cameras(written(lose(6)))


def test_photos_take_their_cameras_along_reduced_with_them(written, tmp_path):
    rng = np.random.default_rng(0)
    for number in range(12):
        write_image(tmp_path / f"photos/{number:06d}.png", rng.integers(0, 255, (120, 160, 3), np.uint8))
    import_photos(tmp_path / "photos", None, 8, tmp_path / "capture", max_side_px=80, cameras=written())
    given = read_given_cameras(tmp_path / "capture/cameras.json")
    assert list(given.images) == [f"{number:06d}.png" for number in range(12)]
    assert given.images["000000.png"].lens == Lens("PINHOLE", 80, 60, (150.0, 150.0, 40.0, 30.0))


def test_a_photo_without_an_entry_or_of_another_shape_is_named(written, tmp_path):
    rng = np.random.default_rng(0)
    for number in range(12):
        write_image(tmp_path / f"photos/{number:06d}.png", rng.integers(0, 255, (160, 120, 3), np.uint8))
    with pytest.raises(StepError, match="160 x 120 px, the photo upright 120 x 160 px"):
        import_photos(tmp_path / "photos", None, 8, tmp_path / "capture", cameras=written())
    with pytest.raises(StepError, match="no entry for the photo 000000.png"):
        import_photos(
            tmp_path / "photos", None, 8, tmp_path / "capture", cameras=written(lambda content: content["images"].pop("000000.png"))
        )
    assert not (tmp_path / "capture").exists()


def test_deviations_must_be_positive_numbers(written):
    with pytest.raises(StepError, match="position_deviation_m is -1"):
        read_given_cameras(written(lambda content: content.update(position_deviation_m=-1)))
    assert read_json(written())["source"] == "a robot's arm"
