"""Wide lenses are told from ordinary ones by matches alone."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from zeroshop_steps.register import colmap
from zeroshop_steps.register.colmap import ColmapOptions, match_and_reconstruct
from zeroshop_steps.register.da3.options import Da3Options
from zeroshop_steps.register.da3.refinement import RoughScene, start_from_cameras
from zeroshop_steps.register.matching.turntable import StationaryMatches
from zeroshop_steps.register.matching.view_graph import ViewGraph
from zeroshop_steps.register.matching.wide_lens import (
    Distortion,
    _find_focal,
    _is_better,
    choose_distortion,
    find_wide_lenses,
    set_lenses,
)
from zeroshop_steps.register.scene.image_set import ImageSet
from zeroshop_steps.register.scene.record import Record, RegistrationFailed, TooFewRegistered

WIDTH, HEIGHT = 1000, 750
NOISE_PX = 0.4
PAIRS = ((0, 1), (1, 2), (2, 3), (3, 4), (0, 2), (1, 3))
PHONE = ("SIMPLE_RADIAL", [1000.0, 500.0, 375.0, -0.08])
WIDE_PHONE = ("OPENCV_FISHEYE", [450.0, 450.0, 500.0, 375.0, 0.1, 0.05, 0.0, 0.0])
ACTION_CAMERA = ("OPENCV_FISHEYE", [560.0, 560.0, 500.0, 375.0, 0.02, -0.01, 0.0, 0.0])


def photograph(lens) -> list[np.ndarray]:
    """Places in five images, in px with noise, of points around and below a thing; not a number where an image does not show one."""
    rng = np.random.default_rng(3)
    model, params = lens
    camera = pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
    ground = np.column_stack([rng.uniform(-3, 3, (900, 2)), np.zeros(900)])
    points = np.concatenate([ground, rng.uniform(-0.4, 0.4, (300, 3)) + [0, 0, 0.4]])
    seen = []
    for azimuth in np.radians([0, 25, 50, 75, 100]):
        away = np.array([np.cos(azimuth) * 0.8, np.sin(azimuth) * 0.8, 0.6]) * params[0] / 400
        forward = -away / np.linalg.norm(away)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        local = (points - away) @ np.stack([right, np.cross(forward, right), forward]).T
        places = np.full((len(points), 2), np.nan)
        front = local[:, 2] > 0.05
        places[front] = camera.img_from_cam(local[front]) + rng.normal(0, NOISE_PX, (front.sum(), 2))
        outside = ((places < 0) | (places > [WIDTH, HEIGHT])).any(1)
        places[outside] = np.nan
        seen.append(places)
    return seen


def match(seen: list[np.ndarray], first: int, second: int) -> np.ndarray:
    """(M, 2) numbers of what both images show, of which a tenth is matched wrongly."""
    both = np.flatnonzero(np.isfinite(seen[first] + seen[second]).all(1))
    other = both.copy()
    other[::10] = np.roll(other[::10], 1)
    return np.column_stack([both, other])


@pytest.mark.parametrize(("lens", "is_wide"), [(PHONE, False), (WIDE_PHONE, True), (ACTION_CAMERA, True)])
def test_the_model_is_chosen_by_likelihood(lens, is_wide):
    seen = photograph(lens)
    pairs = []
    for first, second in PAIRS[:3]:
        rows = match(seen, first, second)
        pairs.append(tuple((seen[one][rows[:, side]] - [WIDTH / 2, HEIGHT / 2]) / WIDTH for side, one in enumerate((first, second))))
    assert choose_distortion(pairs).equidistant == is_wide


def test_a_gain_in_one_pair_alone_tells_no_lens():
    """Such as where RANSAC failed with the other model."""
    costs, errors = np.full(8, 100.0), np.zeros(800)
    failed = costs + [300, 0, 0, 0, 0, 0, 0, 0]
    assert _is_better(costs, costs + 10, 3, errors) and not _is_better(costs, failed, 3, errors)


def test_the_focal_length_is_one_that_a_lens_can_have():
    """Points near the middle alone leave it open; no lens bends more than an orthographic one."""
    rng = np.random.default_rng(0)
    pairs = [(places, places + [0.02, 0] + rng.normal(0, 0.003, (60, 2))) for places in rng.uniform(-0.1, 0.1, (8, 60, 2))]
    for parameter in (0.25, 0.55):
        assert _find_focal(Distortion(True, parameter), pairs, 0) <= np.sqrt(1.5) * parameter


def write_database(path: Path, lens) -> None:
    seen = photograph(lens)
    with pycolmap.Database.open(path) as opened:
        camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[1200.0, 500.0, 375.0, 0.0], camera_id=1)
        opened.write_camera(camera, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=1)
        rig.add_ref_sensor(camera.sensor_id)
        opened.write_rig(rig, use_rig_id=True)
        for number, places in enumerate(seen, start=1):
            opened.write_image(pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number), use_image_id=True)
            opened.write_keypoints(number, np.nan_to_num(places).astype(np.float32))
        for first, second in PAIRS:
            opened.write_matches(first + 1, second + 1, match(seen, first, second).astype(np.uint32))


def test_matches_are_verified_by_the_wide_lens(tmp_path):
    path = tmp_path / "database.db"
    write_database(path, WIDE_PHONE)
    found = find_wide_lenses(path, 0)
    with pycolmap.Database.open(path) as opened:  # two features of the picture's rim, at one place of both photos
        matches, keypoints = opened.read_matches(1, 2), [opened.read_keypoints(image) for image in (1, 2)]
        for image, points in enumerate(keypoints, start=1):
            opened.update_keypoints(image, np.vstack([points, [[100, 300]], [[900, 300]]]).astype(np.float32))
        rim = np.array([[len(points), len(points) + 1] for points in keypoints]).T
        opened.delete_matches(1, 2)
        opened.write_matches(1, 2, np.vstack([matches, rim]).astype(np.uint32))
    set_lenses(path, found, 0)
    with pycolmap.Database.open(path) as opened:
        kept = opened.read_matches(1, 2)
    assert kept.max() < len(keypoints[0]) and len(kept) > 0.99 * len(matches)
    assert found[1].camera.focal_length_x == pytest.approx(450, rel=0.4)
    with pycolmap.Database.open(path) as opened:
        assert opened.read_camera(1).model.name == "RADIAL_FISHEYE"
        pairs = dict(zip(*opened.read_two_view_geometries(), strict=True))
        matched = dict(zip(*opened.read_all_matches(), strict=True))
    assert pairs.keys() == matched.keys()
    for pair_id, geometry in pairs.items():
        assert len(geometry.inlier_matches) > 0.8 * len(matched[pair_id])


def test_a_photo_that_was_held_upright_has_the_same_lens(tmp_path):
    path = tmp_path / "database.db"
    write_database(path, WIDE_PHONE)
    with pycolmap.Database.open(path) as opened:
        opened.write_camera(pycolmap.Camera(model="SIMPLE_RADIAL", width=HEIGHT, height=WIDTH, params=[1200.0, 375.0, 500.0, 0.0]))
        (upright,) = (camera for camera in opened.read_all_cameras() if camera.width == HEIGHT)
        rig = pycolmap.Rig(rig_id=2)
        rig.add_ref_sensor(upright.sensor_id)
        opened.write_rig(rig, use_rig_id=True)
        opened.write_image(pycolmap.Image(name="6.png", camera_id=upright.camera_id, image_id=6), use_image_id=True)
        x, y = opened.read_keypoints(1)[:, :2].T
        opened.write_keypoints(6, np.column_stack([y, WIDTH - x]).astype(np.float32))
        opened.write_matches(2, 6, opened.read_matches(1, 2)[:, ::-1].astype(np.uint32))
    found = find_wide_lenses(path, 0)
    lying, standing = (found[number].camera for number in (1, upright.camera_id))
    assert (standing.width, standing.height) == (HEIGHT, WIDTH) and standing.model == lying.model
    assert np.allclose(standing.params[[1, 2]], [375, 500]) and np.allclose(standing.params[[0, 3, 4]], lying.params[[0, 3, 4]])
    set_lenses(path, found, 0)
    with pycolmap.Database.open(path) as opened:
        assert len(opened.read_two_view_geometry(2, 6).inlier_matches) > 0.8 * len(opened.read_matches(2, 6))


def test_an_ordinary_lens_stays_as_it_is(tmp_path):
    path = tmp_path / "database.db"
    write_database(path, PHONE)
    assert find_wide_lenses(path, 0) == {}


def test_a_refusal_names_the_wide_lens(tmp_path, monkeypatch):
    def refuse(database, image_set, out, options, record, *_):
        raise record.fail("2 of 20 images registered", kind=TooFewRegistered)

    monkeypatch.setattr(colmap, "reconstruct", refuse)
    still = StationaryMatches(0.0, 0.0, 0.0)
    graph = ViewGraph(1000.0, 0, "estimated", 190, still, on_turntable=False, wide_lens=True)
    images = ImageSet((tmp_path / "1.png",), None, ((WIDTH, HEIGHT),))
    with pytest.raises(TooFewRegistered, match=r"2 of 20 images registered\. Besides, .* through a wide lens .* use the 1x lens"):
        match_and_reconstruct(images, tmp_path, tmp_path / "database.db", ColmapOptions(), Record(), match=lambda *_: graph)


def test_depth_anything_refuses_wide_lenses(tmp_path):
    path = tmp_path / "database.db"
    write_database(path, WIDE_PHONE)
    model, params = WIDE_PHONE
    with pycolmap.Database.open(path) as opened:
        opened.update_camera(pycolmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params, camera_id=1))
    images = ImageSet((tmp_path / "1.png",), None, ((WIDTH, HEIGHT),))
    with pytest.raises(RegistrationFailed, match="the matches show a wide lens .* use the registration colmap"):
        start_from_cameras(RoughScene([], None, np.zeros(0)), images, Da3Options(), path)
