"""Captures of several passes side by side, with the truth of rendered films."""

import numpy as np

from helpers.carton_scene import camera_at
from helpers.given import given_cameras
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import read_sparse_model, write_cameras
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.cli import stage_main
from zeroshop_steps.runtime.files import read_json, write_json

FRAMES = ([3, 9], [4, 20])  # of each film, as its capture took them


def write_film(folder, frames):
    """The truth of a film of 24 frames, and a capture of two of them."""
    write_cameras(folder / "film/truth/cameras", [camera_at(f"{number:06d}.png", 15.0 * number, 30.0) for number in range(24)])
    for index in range(len(frames)):
        write_image(folder / f"capture/images/{index:06d}.png", np.zeros((32, 32, 3), np.uint8))
    write_json(folder / "capture/capture.json", {"scene": "video", "images": len(frames), "source_frames": frames})


def test_films_of_two_passes_have_their_true_cameras_in_the_frame_of_the_first(tmp_path):
    turned_from_model = np.diag([1.0, -1.0, -1.0, 1.0])
    turned_from_model[2, 3] = 120.0
    write_json(tmp_path / "turned/turned.json", {"turned_from_model": turned_from_model.tolist()})
    for number, frames in enumerate(FRAMES, start=1):
        write_film(tmp_path / str(number), frames)
    folders = {"captures": "capture", "film-truths": "film/truth"}
    parts = [word for name, part in folders.items() for word in (f"--{name}", *(str(tmp_path / number / part) for number in "12"))]
    words = ["--method", "captures", *parts, "--turned", str(tmp_path / "turned"), "--scene", "video_joined"]
    assert stage_main("zeroshop_steps.join", [*words, "--out", str(tmp_path / "joined")]) == 0
    cameras = {camera.name: camera for camera in read_sparse_model(tmp_path / "joined/truth").cameras}
    first, second = camera_at("", 15.0 * 9, 30.0), camera_at("", 15.0 * 20, 30.0)
    assert np.allclose(cameras["1_000001.png"].camera_from_world, first.camera_from_world)
    # A camera above the object that lies upside down is a camera below the object that stands.
    below = np.linalg.inv(turned_from_model)[:3, :3] @ second.centre_in_world + np.linalg.inv(turned_from_model)[:3, 3]
    assert np.allclose(cameras["2_000001.png"].centre_in_world, below)
    record = read_json(tmp_path / "joined/capture.json")
    assert record["images_of_passes"] == [2, 2] and "source_frames" not in record


def test_the_cameras_that_the_first_pass_brought_stay_with_it(tmp_path):
    cameras = [camera_at(f"{index:06d}.png", 90.0 * index, 30.0) for index in range(2)]
    for number in "12":
        write_film(tmp_path / number, [0, 1])
        given_cameras(cameras).write(tmp_path / number / "capture/cameras.json")
    words = ["--captures", *(str(tmp_path / number / "capture") for number in "12"), "--scene", "joined", "--out", str(tmp_path / "both")]
    assert stage_main("zeroshop_steps.join", ["--method", "captures", *words]) == 0
    assert list(read_given_cameras(tmp_path / "both/cameras.json").poses) == ["1_000000.png", "1_000001.png"]
