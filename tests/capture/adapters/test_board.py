"""Cameras and the lens by a board around the object, drawn here as a lens of known cameras sees it, and in real photos."""

import json

import cv2
import numpy as np
import pytest

from zeroshop_steps.app.importing import import_capture
from zeroshop_steps.capture.adapters.form import ImportOptions
from zeroshop_steps.capture.cameras_json import read_given_cameras
from zeroshop_steps.geometry.cameras.pinhole import fit_similarity
from zeroshop_steps.geometry.cameras.viewpoints import look_at
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.runtime.errors import StepError

SIZE_PX, TEXELS, SIDE_MM = (640, 480), 4, 30
K = np.array([[620.0, 0, 325.0], [0, 620.0, 236.0], [0, 0, 1]])
PLACES = {number: (10 + 45 * (number % 4), 10 + 45 * (number // 4)) for number in range(12) if number not in (5, 6)}


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """A folder of photos of tags around an empty middle, and camera_from_board of each in mm."""
    folder = tmp_path_factory.mktemp("board")
    page = np.full((150 * TEXELS, 200 * TEXELS), 230, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for number, (x, y) in PLACES.items():
        marker = cv2.aruco.generateImageMarker(dictionary, number, SIDE_MM * TEXELS)
        page[y * TEXELS : (y + SIDE_MM) * TEXELS, x * TEXELS : (x + SIDE_MM) * TEXELS] = np.clip(marker, 25, 230)
    tags = {number: [[x, y], [x + SIDE_MM, y], [x + SIDE_MM, y + SIDE_MM], [x, y + SIDE_MM]] for number, (x, y) in PLACES.items()}
    (folder / "board.yaml").write_text(json.dumps({"dictionary": "36h11", "tags": tags}))
    half, poses = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]]), {}
    board_from_texel = np.diag([1 / TEXELS, 1 / TEXELS, 1.0])
    # The board's y points down on the paper, so that its z leads into it.
    turn = np.diag([1.0, -1.0, -1.0, 1.0])
    middle = np.array([100.0, -75.0, 0.0])
    for number in range(9):
        slant = (0.3, 0.6, 0.8)[number % 3]
        direction = np.array([np.cos(0.7 * number) * slant, np.sin(0.7 * number) * slant, np.sqrt(1 - slant**2)])
        pose = look_at(middle + (300 + 15 * (number % 2)) * direction, middle + 5.0 * (number % 2)) @ turn
        homography = np.linalg.inv(half) @ K @ pose[:3, [0, 1, 3]] @ board_from_texel @ half
        photo = cv2.warpPerspective(page, homography, SIZE_PX, flags=cv2.INTER_AREA, borderValue=128)
        write_image(folder / f"photos/{number:04d}.png", np.repeat(photo[..., None], 3, -1))
        poses[f"{number:04d}.png"] = pose
    write_image(folder / "photos/0009.png", np.full((480, 640, 3), 90, np.uint8))
    return folder, poses


def centres_m(poses) -> np.ndarray:
    return np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses.values()])


def test_a_board_gives_cameras_lens_and_metres(photographed, tmp_path):
    folder, poses = photographed
    import_capture(folder / "photos", tmp_path / "ours", ImportOptions(board=str(folder / "board.yaml")))
    given = read_given_cameras(tmp_path / "ours/cameras.json")
    assert given.metric and set(given.poses) == set(poses) and given.images["0009.png"].camera_from_world is None
    fx, fy, cx, cy = given.images["0000.png"].lens.params[:4]
    assert (fx, fy, cx, cy) == pytest.approx((620.0, 620.0, 325.0, 236.0), abs=4.0)
    truth_m = centres_m(poses) / 1000
    assert np.linalg.norm(centres_m(given.poses) - truth_m, axis=1).max() < 2.5e-3


def test_another_board_or_one_without_places_is_refused(photographed, tmp_path):
    folder, _ = photographed
    tags = json.loads((folder / "board.yaml").read_text())
    first, *others = tags["tags"]
    tags["tags"] = {first: tags["tags"][first], **{one: tags["tags"][other] for one, other in zip(others, reversed(others), strict=True)}}
    (tmp_path / "other.yaml").write_text(json.dumps(tags))
    with pytest.raises(StepError, match="another board"):
        import_capture(folder / "photos", tmp_path / "ours", ImportOptions(board=str(tmp_path / "other.yaml")))
    with pytest.raises(StepError, match="says not where its tags lie"):
        import_capture(folder / "photos", tmp_path / "ours", ImportOptions(board="36h11:30"))
    with pytest.raises(StepError, match="0 of 10 photos.*show 8 corners of the board a4"):
        import_capture(folder / "photos", tmp_path / "ours", ImportOptions(board="a4"))
    assert not (tmp_path / "ours").exists()


@pytest.mark.slow
def test_real_photos_of_things_on_a_board(shared_data, tmp_path):
    """31 photos of a paper of AprilTags; its publisher's lens has no distortion, which makes cameras a per cent farther."""
    capture = shared_data / "captures/board"
    tags = json.loads((capture / "truth/board_centered_rotated_mm.json").read_text())
    (tmp_path / "board.yaml").write_text(
        json.dumps({"dictionary": "36h11", "tags": {key: one for key, one in tags.items() if key.isdigit()}})
    )
    import_capture(capture / "images", tmp_path / "ours", ImportOptions(board=str(tmp_path / "board.yaml")))
    given = read_given_cameras(tmp_path / "ours/cameras.json")
    published = json.loads((capture / "truth/cameras_opencv_mm.json").read_text())["camera_from_world"]
    theirs = {name.partition(".")[0]: np.array(pose) for name, pose in published.items()}
    ours = {name.partition(".")[0]: pose for name, pose in given.poses.items()}
    common = sorted(set(ours) & set(theirs))
    one, other = (centres_m({name: poses[name] for name in common}) for poses in (ours, theirs))
    assert len(common) > 25 and np.cbrt(np.linalg.det(fit_similarity(one, other)[:3, :3])) == pytest.approx(1000, rel=0.015)
    assert np.median(np.linalg.norm(1000 * one - other, axis=1)) < 8
