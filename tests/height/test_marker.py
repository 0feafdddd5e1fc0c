"""The board in rendered scenes: beside the object, and in photos of the empty scene that are placed among the object's."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.coarse_ground import coarse_ground
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, write_cameras
from zeroshop_steps.geometry.imaging.images import list_images, read_image, write_image
from zeroshop_steps.height import marker
from zeroshop_steps.height.scene_photos import localize_photos
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json
from zeroshop_steps.synthetic.demo_objects import write_demo_object
from zeroshop_steps.synthetic.raycast import capture
from zeroshop_steps.synthetic.scenes import camera_rings

SIZE = ("--width", "640", "--height", "480")


def run(stage: str, *words: object) -> int:
    return stage_main(f"zeroshop_steps.{stage}", [str(word) for word in words])


def registered_ring(whole: Path, folder: Path) -> Path:
    """Eight of the ten views of a capture, with their true cameras, triangulated."""
    names = [path.name for path in list_images(whole / "images")[-8:]]
    for part in ("images", "masks"):
        (folder / "ring" / part).mkdir(parents=True)
        for name in names:
            shutil.copy(whole / part / name, folder / "ring" / part / name)
    write_cameras(folder / "ring" / "truth", [camera for camera in read_sparse_model(whole / "truth").cameras if camera.name in names])
    words = ("--method", "truth", "--capture", folder / "ring", "--scene", "su_h", "--out", folder / "cameras")
    assert run("register", *words) == 0
    return folder / "cameras"


@pytest.fixture(scope="module", autouse=True)
def ground():
    """A ground that is still finer than these photos show, and the raised ring alone."""
    with coarse_ground(2048), pytest.MonkeyPatch.context() as patch:
        patch.setitem(camera_rings.ELEVATIONS_DEG, "su_h", (45.0,))
        yield


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    write_demo_object("gelatin_carton", folder)
    return folder / "model.ply"


@pytest.fixture(scope="module")
def beside(model, tmp_path_factory) -> Path:
    """Registered views of the carton beside the board."""
    folder = tmp_path_factory.mktemp("beside")
    assert run("synthetic", "--method", "board_scene", "--view", "object", "--model", model, *SIZE, "--out", folder / "capture") == 0
    assert read_json(folder / "capture" / "capture.json")["scene"] == "su_b"
    return registered_ring(folder / "capture", folder)


@pytest.fixture(scope="module")
def apart(model, tmp_path_factory) -> tuple[Path, Path]:
    """Registered views of the carton without a board, and photos of the empty scene with it."""
    folder = tmp_path_factory.mktemp("apart")
    capture(model, "su_h", 640, 480, 0, folder / "capture")
    words = ("--method", "board_scene", "--view", "empty", "--model", model, *SIZE, "--out", folder / "empty")
    assert run("synthetic", *words) == 0
    return registered_ring(folder / "capture", folder), folder / "empty"


@pytest.fixture
def measure(model, tmp_path, capsys):
    """Measure the true model by the board; gives the record or the error. The registration's unit is the millimetre."""

    def by_board(cameras: Path, *words, known_height_m=None):
        write_json(tmp_path / "capture" / "capture.json", {"known_height_m": known_height_m})
        words = ("--mesh", model, "--cameras", cameras, "--capture", tmp_path / "capture", *words, "--out", tmp_path / "height.json")
        status = run("height", "--method", "marker", *words)
        return read_json(tmp_path / "height.json") if status == 0 else capsys.readouterr().err

    return by_board


@pytest.mark.slow
def test_a_board_beside_the_object(beside, measure):
    record = measure(beside)
    assert record["metres_per_unit"] == pytest.approx(0.001, rel=3e-3)
    assert record["scale_source"] == "marker" and record["evidence"]["board_seen_in"] == "the object's photos"
    assert record["evidence"]["residual_px"] < 0.5
    fit_to_page = measure(beside, "--ruler-mm", 145.5)
    assert fit_to_page["metres_per_unit"] == pytest.approx(0.97 * record["metres_per_unit"], rel=1e-9)


@pytest.mark.slow
def test_a_board_that_contradicts_the_known_height_is_refused(beside, measure):
    true_m = measure(beside)["height_m"]
    assert measure(beside, known_height_m=true_m * 1.01)["known_height_m"] == pytest.approx(true_m * 1.01)
    assert "the board was printed at another size" in measure(beside, known_height_m=true_m * 1.1)
    assert measure(beside, "--blind", known_height_m=true_m * 1.1)["height_m"] == pytest.approx(true_m)


@pytest.mark.slow
def test_another_board_than_said_and_none_at_all(beside, apart, measure):
    assert "show the board a4, not a3" in measure(beside, "--board", "a3")
    assert "show no board a4 that could be read" in measure(apart[0])
    assert "--ruler-mm is 15" in measure(beside, "--ruler-mm", 15)


@pytest.mark.slow
def test_a_board_in_the_empty_scene_only(apart, measure, monkeypatch):
    cameras, empty = apart
    placed = []

    def localize(*given):
        placed.extend(localize_photos(*given))
        return placed

    monkeypatch.setattr(marker, "localize_photos", localize)
    record = measure(cameras, "--marker-images", empty / "images")
    assert record["metres_per_unit"] == pytest.approx(0.001, rel=3e-3)
    assert record["evidence"]["board_seen_in"] == "photos of the empty scene" and record["evidence"]["photos"] >= 5
    # The photos are placed where they were taken.
    true = {camera.name: camera for camera in read_sparse_model(empty / "truth").cameras}
    assert len(placed) >= 5
    for photo in placed:
        centre = -photo.camera_from_world[:3, :3].T @ photo.camera_from_world[:3, 3]
        distance_mm = np.linalg.norm(true[photo.path.name].centre_in_world)
        assert np.linalg.norm(centre - true[photo.path.name].centre_in_world) < 0.01 * distance_mm


@pytest.mark.slow
def test_photos_of_another_scene_cannot_be_placed(apart, measure, tmp_path):
    rng = np.random.default_rng(0)
    for path in list_images(apart[1] / "images")[:3]:
        noise = rng.integers(0, 255, (60, 80, 3), dtype=np.uint8).repeat(8, axis=0).repeat(8, axis=1)
        write_image(tmp_path / "elsewhere" / path.name, np.where(rng.uniform(size=noise.shape) < 0.5, noise, read_image(path) // 8))
    assert "must show the same ground" in measure(apart[0], "--marker-images", tmp_path / "elsewhere")
    assert "does not exist" in measure(apart[0], "--marker-images", tmp_path / "nowhere")
