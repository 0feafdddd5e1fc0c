"""The recorder: what it writes is a capture, also when it is killed; it resumes; and it refuses what is of no use, with the reason."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from zeroshop_steps.app.importing import find_source
from zeroshop_steps.capture.cameras_json import Lens, read_given_cameras
from zeroshop_steps.geometry.cameras.viewpoints import direction_at, look_at
from zeroshop_steps.geometry.imaging.images import read_depth_mm, read_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.scan import recorder as recorder_module
from zeroshop_steps.scan.recorder import ScanRecorder

WIDTH, HEIGHT = 160, 120
LENS = Lens("PINHOLE", WIDTH, HEIGHT, (150.0, 150.0, 80.0, 60.0))


def pose(azimuth_deg: float, elevation_deg: float = 30.0) -> np.ndarray:
    return np.linalg.inv(look_at(0.4 * direction_at(np.radians(azimuth_deg), np.radians(elevation_deg)), np.zeros(3)))


def photo(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def depth(depth_m: float = 0.4) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), depth_m, np.float32)


@pytest.fixture
def recorder(tmp_path: Path) -> ScanRecorder:
    return ScanRecorder(tmp_path / "scan", "our arm", 0.001, 0.3)


def test_views_are_a_capture_with_known_cameras(recorder: ScanRecorder) -> None:
    far = depth(0.41234)
    far[:, :10], far[:, 10:20], far[:, 20:30] = np.nan, 0.0, 9.0
    for index in range(3):
        recorder.record(photo(index), far, LENS, pose(40.0 * index))
    given = read_given_cameras(recorder.folder / "cameras.json")
    assert (given.source, given.metric, given.position_deviation_m, given.rotation_deviation_deg) == ("our arm", True, 0.001, 0.3)
    assert list(given.images) == ["0001.png", "0002.png", "0003.png"]
    np.testing.assert_allclose(given.poses["0002.png"], np.linalg.inv(pose(40.0)), atol=1e-9)
    np.testing.assert_array_equal(read_image(recorder.folder / "images/0002.png"), photo(1))
    measured = read_depth_mm(recorder.folder / "depth/0002.png")
    assert measured[0, 50] == pytest.approx(412.3, abs=0.06) and not measured[:, :30].any()
    source = find_source(recorder.folder, recorder.folder.parent, "scan")
    assert source.poses and source.depth and source.cameras


def test_a_view_that_is_upside_down_is_written_upright(recorder: ScanRecorder) -> None:
    steep = np.linspace(0.3, 0.5, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    lens = Lens("PINHOLE", WIDTH, HEIGHT, (150.0, 150.0, 70.0, 55.0))
    view = recorder.record(photo(), steep, lens, pose(0) @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    np.testing.assert_allclose(view.world_from_camera, pose(0), atol=1e-12)
    assert view.lens.params == (150.0, 150.0, WIDTH - 70.0, HEIGHT - 55.0)
    np.testing.assert_array_equal(read_image(recorder.folder / "images/0001.png"), photo()[::-1, ::-1])
    np.testing.assert_allclose(recorder.read_depth_m(view), steep[::-1, ::-1], atol=1e-4)


def test_without_depth_there_is_no_folder_of_depth(recorder: ScanRecorder) -> None:
    recorder.record(photo(), None, LENS, pose(0))
    assert not (recorder.folder / "depth").exists()
    assert read_given_cameras(recorder.folder / "cameras.json").depth_step_mm is None


def test_a_folder_is_continued(recorder: ScanRecorder) -> None:
    for azimuth in (0.0, 40.0):
        recorder.record(photo(), depth(), LENS, pose(azimuth))
    again = ScanRecorder(recorder.folder, "our arm")
    assert [view.name for view in again.views] == ["0001.png", "0002.png"]
    np.testing.assert_allclose(again.views[1].world_from_camera, pose(40.0), atol=1e-9)
    np.testing.assert_allclose(again.read_depth_m(again.views[0]), 0.4, atol=1e-4)
    assert again.record(photo(), depth(), LENS, pose(80.0)).name == "0003.png"
    assert len(read_given_cameras(recorder.folder / "cameras.json").images) == 3


@pytest.mark.parametrize("killed_in", ["write_depth_mm", "write_image", "cameras"])
def test_a_scan_that_is_killed_is_a_capture(recorder: ScanRecorder, monkeypatch: pytest.MonkeyPatch, killed_in: str) -> None:
    recorder.record(photo(), depth(), LENS, pose(0))

    def kill(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if killed_in == "cameras":
            patch.setattr(recorder_module.GivenCameras, "write", kill)
        else:
            patch.setattr(recorder_module, killed_in, kill)
        with pytest.raises(KeyboardInterrupt):
            recorder.record(photo(1), depth(0.3), LENS, pose(40))
    photos = {path.name for path in (recorder.folder / "images").iterdir()}
    assert photos == {"0001.png"}
    given = read_given_cameras(recorder.folder / "cameras.json")
    given.for_photos({name: name for name in photos}, dict.fromkeys(photos, (WIDTH, HEIGHT)), recorder.folder)
    again = ScanRecorder(recorder.folder, "our arm")
    assert [view.name for view in again.views] == ["0001.png"]
    view = again.record(photo(2), None, LENS, pose(80))
    # No depth of the view that was not finished stays with the one that took its number.
    assert again.read_depth_m(view) is None
    assert ScanRecorder(recorder.folder, "our arm").read_depth_m(view) is None
    assert [one.has_depth for one in ScanRecorder(recorder.folder, "our arm").views] == [True, False]


def mirrored() -> np.ndarray:
    return pose(40) @ np.diag([1.0, 1.0, -1.0, 1.0])


def scaled() -> np.ndarray:
    return pose(40) @ np.diag([2.0, 2.0, 2.0, 1.0])


def lost() -> np.ndarray:
    return np.full((4, 4), np.nan)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: {"rgb": photo().astype(float)}, r"float64 of the shape \(120, 160, 3\); expected uint8"),
        (lambda: {"rgb": photo()[:, :100]}, r"\(120, 100, 3\).*\(120, 160, 3\), as the lens says"),
        (lambda: {"rgb": photo()[..., 0]}, r"\(120, 160\)"),
        (lambda: {"depth_m": depth()[:60]}, r"depth has the shape \(60, 160\).*aligned"),
        (lambda: {"depth_m": 0 * depth()}, "no pixel was measured"),
        (lambda: {"depth_m": 1000 * depth()}, "looks like millimetres"),
        (lambda: {"world_from_camera": np.eye(3)}, r"shape \(3, 3\)"),
        (lambda: {"world_from_camera": lost()}, "tf lost the camera"),
        (lambda: {"world_from_camera": mirrored()}, "left-handed"),
        (lambda: {"world_from_camera": scaled()}, "it scales by 2"),
        (lambda: {"world_from_camera": pose(0.1)}, r"the view of 0001\.png again"),
    ],
)
def test_what_is_of_no_use_is_refused(recorder: ScanRecorder, change: Callable[[], dict], message: str) -> None:
    good = {"rgb": photo(), "depth_m": depth(), "lens": LENS, "world_from_camera": pose(0)}
    recorder.record(**good)
    with pytest.raises(StepError, match=message):
        recorder.record(**{**good, "world_from_camera": pose(40), **change()})
    assert len(list((recorder.folder / "images").iterdir())) == len(recorder.views) == 1


def test_a_blurred_photo_is_refused(recorder: ScanRecorder) -> None:
    import cv2

    blocks = np.kron(photo()[:15, :20], np.ones((32, 32, 1), np.uint8))
    lens = Lens("PINHOLE", 640, 480, (600.0, 600.0, 320.0, 240.0))
    with pytest.raises(StepError, match=r"blurred.*wait until the arm stands still"):
        recorder.record(cv2.GaussianBlur(blocks, (0, 0), 4), None, lens, pose(0))
    recorder.record(blocks, None, lens, pose(0))


def test_an_arm_that_moves_is_refused(recorder: ScanRecorder) -> None:
    for step in range(5):
        recorder.watch(pose(0.2 * step), 10.0 + 0.1 * step)
    with pytest.raises(StepError, match=r"not at rest: within 0\.3 s the camera moved by \d"):
        recorder.record(photo(), depth(), LENS, pose(0.8), 10.4)
    for step in range(5):
        recorder.watch(pose(0.8), 10.5 + 0.1 * step)
    recorder.record(photo(), depth(), LENS, pose(0.8), 10.9)


def test_another_capture_is_not_continued(recorder: ScanRecorder) -> None:
    recorder.record(photo(), depth(), LENS, pose(0))
    (recorder.folder / "images/own.png").write_bytes((recorder.folder / "images/0001.png").read_bytes())
    with pytest.raises(StepError, match=r"does not know, such as own\.png.*new folder"):
        ScanRecorder(recorder.folder, "our arm")
