"""Films and photos that show one side alone, a thing that moves, or a thing that is cut off; and those that only seem to."""

import functools

import cv2
import numpy as np
import pytest
from PIL import Image

from zeroshop_steps.app import check
from zeroshop_steps.app.check import check_capture, measure_turn_deg
from zeroshop_steps.app.moved_things import follow_points, judge_motion
from zeroshop_steps.capture import bridging
from zeroshop_steps.capture.bridging import find_features
from zeroshop_steps.geometry.cameras.viewpoints import look_at

SIZE = (320, 240)


@functools.cache
def print_of(seed, side=900, cell=8):
    """A texture as of a newspaper."""
    cells = np.random.default_rng(seed).integers(0, 255, (side // cell, side // cell, 3), dtype=np.uint8)
    return cv2.resize(cells, (side, side), interpolation=cv2.INTER_CUBIC)


def see_table(azimuth_deg, elevation_deg=50.0):
    """A printed table, 900 units wide, and a carton on it, from this side."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    place = 700 * np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    camera_from_world = look_at(place, np.zeros(3))
    intrinsics = np.array([[320.0, 0, 160], [0, 320, 120], [0, 0, 1]])
    image = np.full((SIZE[1], SIZE[0], 3), 128, np.uint8)
    for height, side, seed in ((0.0, 900, 1), (40.0, 120, 2)):
        plane = np.column_stack(
            [camera_from_world[:3, 0], camera_from_world[:3, 1], camera_from_world[:3, 3] + height * camera_from_world[:3, 2]]
        )
        corner = np.array([[1, 0, -side / 2], [0, 1, -side / 2], [0, 0, 1.0]])
        warp = intrinsics @ plane @ corner
        cv2.warpPerspective(print_of(seed, side, 10), warp, SIZE, dst=image, borderMode=cv2.BORDER_TRANSPARENT)
    return image


@pytest.mark.parametrize("turn_deg", [60.0, 250.0])
def test_the_turn_of_the_camera_is_measured(turn_deg):
    measured = measure_turn_deg([find_features(see_table(angle)) for angle in np.linspace(0, turn_deg, 6)])
    assert measured == pytest.approx(turn_deg, abs=0.15 * turn_deg + 3)


def test_pictures_that_are_not_tied_do_not_tell_how_far_the_camera_turned():
    strange = [find_features(print_of(seed, 240)) for seed in range(6)]
    assert measure_turn_deg(strange) is None


def play(camera=5.0, thing=7.5, turn_deg=0.0, frames=44):
    """A film by a camera that moves sideways, in which a disk lies before its background, moves by itself, or turns."""
    background, picture = print_of(1), print_of(2, 160)
    rows, columns = np.mgrid[:160, :160] - 79.5
    alpha = (rows**2 + columns**2 < 60**2).astype(np.uint8)
    for number in range(frames):
        image = cv2.warpAffine(background, np.float32([[1, 0, -camera * number], [0, 1, -100]]), SIZE, borderMode=cv2.BORDER_REFLECT)
        place = cv2.getRotationMatrix2D((79.5, 79.5), turn_deg * number, 1.0)
        place[:, 2] += [80 + 66 - (thing * number) % 133, 40 + (20 * np.sin(number / 3) if turn_deg else 0)]
        shown = cv2.warpAffine(alpha, place, SIZE)[..., None] > 0
        yield np.where(shown, cv2.warpAffine(picture, place, SIZE), image)


@pytest.mark.parametrize(
    ("options", "problem", "warning"),
    [
        ({}, "", ""),
        ({"thing": 0.0, "turn_deg": 5.0}, "parts of the picture move against each other", ""),
        ({"camera": 0.0, "thing": 0.0, "turn_deg": 0.0}, "", ""),
        ({"camera": 0.0, "thing": 3.0, "turn_deg": 0.0}, "", "the background stands still while the object turns"),
    ],
)
def test_a_thing_that_moves_against_its_background_is_seen(options, problem, warning):
    problems, warnings = judge_motion(follow_points(play(**options), range(0, 40, 9)))
    for told, wanted in ((problems, problem), (warnings, warning)):
        assert [wanted in line for line in told] == ([True] if wanted else [])


@pytest.mark.parametrize(("cut", "problem"), [(8, True), (7, True), (6, False), (0, False)])
def test_an_object_that_is_cut_off_throughout_is_a_problem(monkeypatch, tmp_path, cut, problem):
    whole, part = np.zeros((2, 240, 320), np.float32)
    whole[80:200, 100:200], part[80:, 100:200] = 1, 1

    class Network:
        def __init__(self, path):
            pass

        def predict_all(self, views, sizes_px):
            return [part] * cut + [whole] * (len(views) - cut)

    monkeypatch.setattr(check, "SalientObjectNetwork", Network)
    monkeypatch.setattr(check, "find_weights_home", lambda: tmp_path)
    assert check._find_cut_off([np.zeros((480, 640, 3), np.uint8)] * 8, []) == []
    weights = tmp_path / check.NETWORKS[check.DEFAULT].path
    weights.parent.mkdir(parents=True)
    weights.touch()
    told = check._find_cut_off([np.zeros((480, 640, 3), np.uint8)] * 8, [])
    assert [f"cut off at the border in {cut} of 8 pictures: step back" in line for line in told] == ([True] if problem else [])


@pytest.mark.parametrize("left", [0, 40])
def test_whether_cut_outs_are_cut_off_is_said_by_what_is_left_of_them(tmp_path, left):
    for index in range(8):
        pixels = np.random.default_rng(index).integers(0, 255, (90, 120, 4), dtype=np.uint8)
        pixels[..., 3] = 0
        pixels[30:60, left : left + 40, 3] = 255
        Image.fromarray(pixels).save(tmp_path / f"{index}.png")
    problems, _ = check_capture(tmp_path)
    assert ["cut off at the border in 8 of 8 pictures" in line for line in problems] == ([True] if left == 0 else [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "problem", "warning"), [("apple_film", "", "one side alone is seen"), ("teddy_moved", "move against each other", "one side")]
)
def test_poor_films_of_others_are_told(shared_data, monkeypatch, tmp_path, name, problem, warning):
    film = shared_data / "captures" / name / "film.mp4"
    if not film.is_file():
        pytest.skip(f"{film} is not there")
    monkeypatch.setattr(check, "find_weights_home", lambda: tmp_path)  # as before anything was downloaded
    for module, name, less in ((bridging, "SIDE_PX", 400), (check, "PIECES", 5), (check, "VIEWS", 6)):  # in two thirds of the time
        monkeypatch.setattr(module, name, less)
    problems, warnings = check_capture(film)
    assert [problem in line for line in problems] == ([True] if problem else [])
    assert any(warning in line for line in warnings)
