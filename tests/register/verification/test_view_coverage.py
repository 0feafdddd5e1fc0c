"""Where no photo looks from is found, and said."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zeroshop_steps.geometry.cameras.pinhole import Camera, write_cameras
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.register.registration import write_registration
from zeroshop_steps.register.verification.view_coverage import LEAST_TURN_DEG, check_spread, measure_view_coverage
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def cameras(azimuths_deg, elevations_deg, turn=None):
    """Cameras around the origin of a world that is turned as a whole."""
    found = []
    for index, (azimuth, elevation) in enumerate(zip(np.radians(azimuths_deg), np.radians(elevations_deg), strict=True)):
        centre = 3 * np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        pose = look_at(centre, np.zeros(3))
        if turn is not None:
            pose[:3, :3] = pose[:3, :3] @ turn.T
        found.append(Camera(f"{index:06d}.png", 640, 480, K, pose))
    return found


AROUND = np.arange(0, 360, 30)


@pytest.mark.parametrize("turn", [None, Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix()], ids=["upright", "turned"])
def test_two_rounds_are_enough(turn):
    found = measure_view_coverage(cameras(AROUND, np.where(AROUND % 60 == 0, 15, 45), turn))
    assert found.largest_gap_deg == pytest.approx(30, abs=1) and found.elevations_deg == pytest.approx((15, 45), abs=1)
    assert found.advice() == []


def test_a_missing_side_is_named():
    kept = AROUND[(AROUND <= 90) | (AROUND >= 210)]
    found = measure_view_coverage(cameras(kept, np.where(kept % 60 == 0, 15, 45)))
    assert found.largest_gap_deg == pytest.approx(120, abs=1)
    assert set(found.gap_between) == {f"{list(kept).index(90):06d}.png", f"{list(kept).index(210):06d}.png"}
    [line] = found.advice()
    assert "no photo within 120 degrees" in line and "film from there" in line


@pytest.mark.parametrize(
    ("elevation_deg", "words"), [(30, ["from about one height"]), (4, ["one height", "the top"]), (72, ["one height", "from above"])]
)
def test_one_round_alone_is_told(elevation_deg, words):
    advice = measure_view_coverage(cameras(AROUND, np.full(len(AROUND), float(elevation_deg)))).advice()
    assert len(advice) == len(words) and all(any(word in line for line in advice) for word in words)


@pytest.mark.parametrize(("azimuths_deg", "refused"), [(np.arange(0, 16, 3), True), (np.arange(0, 40, 5), False), (AROUND, False)])
def test_cameras_that_all_look_from_one_side_are_refused(azimuths_deg, refused):
    around = cameras(azimuths_deg, np.full(len(azimuths_deg), 30.0))
    if refused:
        with pytest.raises(StepError, match="from nearly the same direction, within 1[0-9] degrees"):
            check_spread(around)
    else:
        check_spread(around)


def test_more_spread_is_asked_of_cameras_before_a_background_that_stood_still():
    around = cameras(np.linspace(0, 40, 6), [20] * 6)
    check_spread(around)
    with pytest.raises(StepError, match="nearly the same direction"):
        check_spread(around, LEAST_TURN_DEG)


def test_a_photo_from_straight_above_closes_no_gap():
    found = measure_view_coverage(cameras([0, 30, 60, 90, 200], [20, 40, 20, 40, 88]))
    assert found.largest_gap_deg == pytest.approx(270, abs=2)


def test_cameras_that_look_apart_have_no_directions():
    away = [Camera(c.name, 640, 480, K, np.diag([-1.0, 1.0, -1.0, 1.0]) @ c.camera_from_world) for c in cameras(AROUND, AROUND * 0 + 20)]
    with pytest.raises(StepError, match="look away"):
        measure_view_coverage(away)


def test_the_record_and_the_log_have_it(tmp_path, capsys):
    def register(folder):
        write_cameras(folder / "sparse", cameras(AROUND[:6], np.full(6, 30.0)))
        return {"method": "colmap"}

    write_registration(tmp_path / "scene", register)
    record = read_json(tmp_path / "scene/registration.json")
    assert record["directions"]["largest_gap_deg"] == pytest.approx(210, abs=1) and len(record["advice"]) == 2
    assert capsys.readouterr().err.count("warning: too few directions") == 2
